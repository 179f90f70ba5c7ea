"""`track-range fleet`: many recordings on the workers of a Ray cluster."""

from track_range.cli.shared.lazy import Lazy, lazy_app

app = lazy_app(
    {
        "run": Lazy(
            "track_range.cli.commands.fleet.run",
            "Process many recordings on this machine or on a Ray cluster.",
            "The same command continues after an interruption: clips that are complete and "
            "unchanged are skipped. All options of `track-range run` except inputs and outputs "
            "apply to every clip. Exit status 3 = some clips failed. Requires the extra fleet.",
            (
                "track-range fleet run recordings/ --out results",
                "track-range fleet run drives/ --pattern '{clip}_left.mp4,{clip}_right.mp4' \\\n"
                "      --rig 'rigs/{clip}.yaml' --out results --workers 4",
                "track-range fleet run clips.csv --out s3://bucket/results --address auto",
            ),
        ),
        "status": Lazy(
            "track_range.cli.commands.fleet.report:status_app",
            "Show the progress of a fleet, during and after a run.",
            examples=("track-range fleet status results",),
        ),
        "events": Lazy(
            "track_range.cli.commands.fleet.events",
            "List the events of a fleet that meet a condition, and copy their videos.",
            "The condition compares columns of events.csv and labels of the clips with texts and "
            "numbers: ==, !=, <, <=, >, >=, in (...), is None, and, or, not. An unknown value "
            "meets no comparison. Kinds: forward_collision, close_following, hard_approach, "
            "cut_in, pedestrian_on_path, near_miss; cut-in is understood.",
            (
                "track-range fleet events results 'kind == \"cut-in\" and min_ttc_s < 2' \\\n"
                "      --clips cut-ins",
                "track-range fleet events results 'class == \"car\" and warning_s is not None' \\\n"
                "      --json events.json",
            ),
        ),
        "report": Lazy(
            "track_range.cli.commands.fleet.report",
            "Print the figures of all clips of a fleet, and write them as one HTML page.",
            "The report covers road users, distance coverage, closest approaches, times to "
            "collision, errors, calibration drift, failures and throughput. It also works during a "
            "run, and names missing and damaged parts.",
            (
                "track-range fleet report results --html results/fleet.html",
                "track-range fleet report s3://bucket/results --json fleet.json",
            ),
        ),
    }
)
