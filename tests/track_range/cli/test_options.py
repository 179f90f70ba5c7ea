"""Options declared as fields: Typer parameters, and values passed on."""

from pathlib import Path
from typing import Annotated, Literal

import pytest
from typer.testing import CliRunner

from track_range.cli.lazy import single_app
from track_range.cli.parameters import command, parameters
from track_range.foundation.errors import UsageError
from track_range.foundation.options import Options, option
from track_range.run.settings import RunSettings, settings_from


class Recipe(Options):
    dish: Annotated[str, option("Dish to cook.", metavar="DISH", is_argument=True)]
    guests: Annotated[int, option("Number of guests.", metavar="N", ge=1, le=9, panel="Table")] = 4
    spices: Annotated[tuple[str, ...], option("Spices to add.")] = ()
    books: Annotated[tuple[Path, ...], option("Book to look into.", flag="--book", is_repeated=True)] = ()
    heat: Annotated[Literal["low", "high"], option("Heat of the stove.")] = "low"
    stirred: Annotated[bool, option("Stirring.", flag="--stir/--no-stir", old_names=("agitated",))] = True
    secret: Annotated[float, option("Secret ingredient.", is_file_only=True)] = 0.5


@pytest.fixture
def cook():
    """Runs the command; returns the options passed to the function, or the result of a failed call."""

    def run(*arguments):
        cooked = []
        result = CliRunner().invoke(single_app(command(Recipe, cooked.append)), [str(item) for item in arguments])
        return cooked[0] if cooked else result

    return run


def test_defaults_come_from_the_model(cook):
    assert cook("soup") == Recipe(dish="soup")


def test_values_reach_the_model(cook):
    cooked = cook("soup", "--guests", 7, "--spices", "salt, dill", "--book", "a", "--book", "b", "--heat", "high")
    assert cooked == Recipe(dish="soup", guests=7, spices=("salt", "dill"), books=(Path("a"), Path("b")), heat="high")
    assert cook("soup", "--no-stir").stirred is False


def test_old_name_is_accepted_and_hidden(cook):
    assert cook("soup", "--no-agitated").stirred is False
    assert cook("soup", "--agitated", "--no-stir").stirred is False  # the current name has precedence
    help_text = cook("--help").output
    assert "--stir" in help_text
    assert "agitated" not in help_text


def test_old_name_in_a_settings_file():
    assert Recipe(dish="soup", agitated=False).stirred is False
    pair = {"stereo": ("a.mp4", "b.mp4")}
    assert settings_from({**pair, "overlay_side": True}).overlay_disparity is True


@pytest.mark.parametrize(
    "arguments", [("soup", "--guests", 0), ("soup", "--guests", 10), ("soup", "--heat", "none"), ()]
)
def test_values_out_of_bounds_are_wrong_usage(cook, arguments):
    assert cook(*arguments).exit_code == 2


def test_file_only_field_is_no_option(cook):
    assert cook("soup", "--secret", 1).exit_code == 2
    assert Recipe(dish="soup", secret=1.0).secret == 1.0


def test_invalid_values_from_python():
    with pytest.raises(UsageError, match=r"^--guests: "):
        Recipe.of({"dish": "soup", "guests": 0})
    with pytest.raises(UsageError, match=r"^DISH: "):
        Recipe.of({})
    with pytest.raises(UsageError, match="salt"):
        Recipe.of({"dish": "soup", "salt": 1})


def test_parameters_show_panel_metavar_and_bounds():
    guests = next(item for item in parameters(Recipe) if item.name == "guests")
    (info,) = guests.annotation.__metadata__
    assert (info.help, info.metavar, info.rich_help_panel) == ("Number of guests (default: 4).", "N", "Table")
    assert (info.min, info.max) == (1, 9)
    assert guests.default == 4


def test_only_given_parameters_name_their_defaults():
    listed = {item.name: item for item in parameters(RunSettings, is_only_given=True)}
    assert {item.default for item in listed.values()} == {None}
    assert "(default: 10)" in listed["folder_fps"].annotation.__metadata__[0].help
    assert "sgbm_options" not in listed


def test_every_setting_of_a_run_has_a_help_text():
    for name, field in RunSettings.model_fields.items():
        assert field.description, name
        assert field.description[0].isupper(), name
        assert field.description.endswith("."), name
