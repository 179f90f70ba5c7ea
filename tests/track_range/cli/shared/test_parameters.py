"""Options declared as fields: Typer parameters, and values passed on."""

from pathlib import Path
from typing import Annotated, Literal

import pytest
from typer.testing import CliRunner

from track_range.cli.shared.parameters import command, parameters
from track_range.fleet.inputs.clip import CLIP_SETTINGS, is_file_setting
from track_range.foundation.errors import UsageError
from track_range.foundation.schemas.options import Options, option, option_of
from track_range.results.formats.provenance import _NOT_HASHED
from track_range.results.writers import WRITERS, create_writer
from track_range.run.options.output import OutputOptions
from track_range.run.options.precedence import settings_from
from track_range.run.options.settings import RunSettings


class Recipe(Options):
    dish: Annotated[str, option("Dish to cook.", metavar="DISH", is_argument=True)]
    guests: Annotated[int, option("Number of guests.", metavar="N", ge=1, le=9, panel="Table")] = 4
    spices: Annotated[tuple[str, ...], option("Spices to add.")] = ()
    books: Annotated[
        tuple[Path, ...], option("Book to look into.", flag="--book", is_repeated=True)
    ] = ()
    heat: Annotated[Literal["low", "high"], option("Heat of the stove.")] = "low"
    form: Annotated[str, option("Form of the noodles.", choices=lambda: ("long", "short"))] = "long"
    salt: Annotated[str, option("Salt.", words=("auto", "off"), metavar="GRAMS")] = "auto"
    stirred: Annotated[
        bool, option("Stirring.", flag="--stir/--no-stir", old_names=("agitated",))
    ] = True
    secret: Annotated[float, option("Secret ingredient.", is_file_only=True)] = 0.5


@pytest.fixture
def cook():
    """Runs the command; returns the options passed to the function, or the result of a failed
    call."""

    def run(*arguments):
        cooked = []
        result = CliRunner().invoke(
            command(Recipe, cooked.append), [str(item) for item in arguments]
        )
        return cooked[0] if cooked else result

    return run


def test_defaults_come_from_the_model(cook):
    assert cook("soup") == Recipe(dish="soup")


def test_values_reach_the_model(cook):
    cooked = cook(
        "soup",
        "--guests",
        7,
        "--spices",
        "salt, dill",
        "--book",
        "a",
        "--book",
        "b",
        "--heat",
        "high",
    )
    assert cooked == Recipe(
        dish="soup", guests=7, spices=("salt", "dill"), books=(Path("a"), Path("b")), heat="high"
    )
    assert cook("soup", "--no-stir").stirred is False


def test_old_name_is_accepted_and_hidden(cook):
    assert cook("soup", "--no-agitated").stirred is False
    # the current name has precedence
    assert cook("soup", "--agitated", "--no-stir").stirred is False
    help_text = cook("--help").output
    assert "--stir" in help_text
    assert "agitated" not in help_text


def test_old_name_in_a_settings_file():
    assert Recipe(dish="soup", agitated=False).stirred is False
    pair = {"stereo": ("a.mp4", "b.mp4")}
    assert settings_from({**pair, "overlay_side": True}).overlay_disparity is True


@pytest.mark.parametrize(
    "arguments",
    [
        ("soup", "--guests", 0),
        ("soup", "--guests", 10),
        ("soup", "--heat", "none"),
        ("soup", "--form", "round"),
        (),
    ],
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
    with pytest.raises(UsageError, match="pepper"):
        Recipe.of({"dish": "soup", "pepper": 1})


def test_choices_and_words_are_listed():
    shown = {item.name: item.annotation.__metadata__[0].metavar for item in parameters(Recipe)}
    assert (shown["heat"], shown["form"], shown["salt"]) == (
        "low|high",
        "long|short",
        "auto|off|GRAMS",
    )
    with pytest.raises(UsageError, match=r"^--form: .*'long'.*'short'.*'round'"):
        Recipe.of({"dish": "soup", "form": "round"})


def test_values_of_files_and_python():
    recipe = Recipe.of({"dish": Path("soup"), "salt": False, "books": ["a"], "spices": "salt,dill"})
    assert (recipe.dish, recipe.salt, recipe.books, recipe.spices) == (
        "soup",
        "off",
        (Path("a"),),
        ("salt", "dill"),
    )
    assert Recipe.of({"dish": ["soup", "bread"], "salt": 2.5}).model_dump(
        include={"dish", "salt"}
    ) == {
        "dish": "soup,bread",
        "salt": "2.5",
    }


def test_parameters_show_panel_metavar_and_bounds():
    guests = next(item for item in parameters(Recipe) if item.name == "guests")
    (info,) = guests.annotation.__metadata__
    assert (info.help, info.metavar, info.rich_help_panel) == (
        "Number of guests (default: 4).",
        "N",
        "Table",
    )
    assert (info.min, info.max) == (1, 9)
    # the model has the default
    assert (guests.default, Recipe.of({"dish": "soup"}).guests) == (None, 4)


def test_only_given_parameters_name_their_defaults():
    listed = {item.name: item for item in parameters(RunSettings, is_only_given=True)}
    assert {item.default for item in listed.values()} == {None}
    assert "(default: 0)" in listed["yaw_deg"].annotation.__metadata__[0].help
    assert "sgbm_options" not in listed


def test_every_setting_of_a_run_has_a_help_text():
    for name, field in RunSettings.model_fields.items():
        assert field.description, name
        assert field.description[0].isupper(), name
        assert field.description.endswith("."), name


def test_every_setting_of_a_run_has_a_stage():
    stages = {name: RunSettings.stage_of(name) for name in RunSettings.model_fields}
    assert set(stages.values()) == {"detections", "tracks", "events", "outputs"}
    assert {name for name, stage in stages.items() if stage == "outputs"} == _NOT_HASHED
    assert [name for name, stage in stages.items() if stage == "events"] == ["event_options"]
    # the blur takes more boxes than a detector reports
    assert stages["anonymize"] == "detections"
    for name, field in OutputOptions.model_fields.items():
        assert option_of(field).stage, name  # a wrong default would keep results of other options


def test_help_names_the_files_of_all_writers():
    help_text = RunSettings.model_fields["write"].description
    for name in WRITERS.names:
        writer = create_writer(name)
        if type(writer).__module__.startswith("track_range."):
            assert f"{name} ({writer.files[0]}" in help_text


def test_settings_of_clips_and_fleets():
    """A new option of a run is none of a clip; those that a fleet refuses say what to do
    instead."""
    refused = RunSettings.fields_where(lambda field: option_of(field).instead)
    assert refused == {
        *("stereo", "mono", "truth", "detections", "start_utc", "table", "realtime"),
        *("known_distance", "overwrite"),
    }
    assert {"rig", "focal_px", "ego_speed", "align"} <= CLIP_SETTINGS
    assert CLIP_SETTINGS.isdisjoint(
        RunSettings.fields_where(lambda field: option_of(field).is_shared)
    )
    assert [name for name in sorted(CLIP_SETTINGS) if is_file_setting(name, "a")] == [
        *("align", "curves", "detections", "ego_speed", "ground", "rig", "truth", "truth_calib"),
        "truth_poses",
    ]
    assert not any(
        is_file_setting(name, value)
        for name in ("align", "ego_speed")
        for value in ("auto", "off", "30.5")
    )
