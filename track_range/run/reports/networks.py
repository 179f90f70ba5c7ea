"""Networks: the networks that a run measured with, and the methods that it only shows."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from track_range.pipeline.clock import StageClock
from track_range.pipeline.ranging import RangingStage
from track_range.results.summary import stage_times_ms
from track_range.results.table import RunRows
from track_range.run.reports.report import Reports


@dataclass(frozen=True, slots=True)
class Networks(Reports):
    """Sections `networks` and `shown_only` of summary.json, in runs that have such methods."""

    ranging: RangingStage
    clock: StageClock
    rows: RunRows

    def summary(self) -> Mapping[str, Any]:
        """Each network with its method, and how its file is understood; its time in ms per
        frame.
        """
        times_ms = stage_times_ms(self.clock.busy_s, len(self.rows))
        networks = [
            {
                "method": name,
                "file": ranger.network.path.name,
                **ranger.network.described,
                "ms_per_frame": times_ms[name],
            }
            for name, ranger in self.ranging.rangers.items()
            if ranger.network is not None
        ]
        shown_only = [name for name in self.ranging.rangers if name in self.ranging.shown_only]
        return {
            **({"networks": networks} if networks else {}),
            **({"shown_only": shown_only} if shown_only else {}),
        }
