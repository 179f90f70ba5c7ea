"""Parts of a run that report."""

from track_range.run.reports.report import Facts, Reports, notes_of, summary_of


class Weather(Reports):
    """A part with messages and no figures."""

    def __init__(self, *notes: str) -> None:
        self._notes = notes

    def notes(self) -> tuple[str, ...]:
        return self._notes


def test_parts_report_in_their_order():
    parts = [Weather("It rains."), Facts({"b": 1, "a": 2}), Weather(), Facts({"c": 3})]
    assert notes_of(parts) == ["It rains."]
    assert list(summary_of(parts).items()) == [("b", 1), ("a", 2), ("c", 3)]


def test_the_same_note_of_two_parts_is_given_once():
    assert notes_of([Weather("CPU.", "Rain."), Weather("Wind.", "CPU.")]) == [
        "CPU.",
        "Rain.",
        "Wind.",
    ]
