"""Every folder of the cases has a test in one of the files beside this one."""

from pathlib import Path


def test_every_case_has_a_test(shared_data: Path) -> None:
    tests = [file.read_text(encoding="utf-8") for file in Path(__file__).parent.glob("test_*.py")]
    folders = [folder.name for folder in (shared_data / "cases").iterdir() if folder.is_dir()]
    assert [name for name in folders if not any(name in text for text in tests)] == []
