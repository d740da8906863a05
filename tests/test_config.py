"""Settings: ranges, contradictions, files, and writing them back to a file."""

import dataclasses
import math
import pickle
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from refusals import refused

from acoustube.air import sound_speed
from acoustube.base.errors import ConfigError
from acoustube.base.limits import CLEARANCE, JOINED_CLEARANCE, pressed_reach
from acoustube.base.rules import Choice, File, Number
from acoustube.indentation import Indenter
from acoustube.indentation.indenters import touch_height
from acoustube.runs import simulate as simulation
from acoustube.runs.config import (
    Config,
    IndentationSettings,
    Mechanics,
    SignalSettings,
    TubeSettings,
    WaveSettings,
    load_config,
    to_toml,
)
from acoustube.runs.config.si import settings_in_si
from acoustube.runs.simulate import simulate

ROOT = Path(__file__).parents[1]
SECTIONS = (TubeSettings, IndentationSettings, WaveSettings, SignalSettings)
NUMBERS = [
    pytest.param(section, field.name, field.metadata["rule"], id=field.name)
    for section in SECTIONS
    for field in dataclasses.fields(section)
    if isinstance(field.metadata["rule"], Number)
]
NUMBERS_BY_NAME = [pytest.param(*case.values[:2], id=case.id) for case in NUMBERS]
CHOICES = [
    pytest.param(section, field.name, field.metadata["rule"], id=field.name)
    for section in SECTIONS
    for field in dataclasses.fields(section)
    if isinstance(field.metadata["rule"], Choice)
]


def test_defaults_are_the_papers():
    config = Config()
    assert config.tube.inner_diameter_mm == 7.9
    assert config.tube.outer_diameter_mm == pytest.approx(11.1)
    assert config.tube.shore_a == 35
    assert config.tube.shear_modulus_mpa is None
    assert config.waves.frequency_khz == 42
    assert config.waves.cycles == 11
    assert config.waves.probe_cm == 2


@pytest.mark.parametrize(("section", "name", "rule"), NUMBERS)
@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf, -1e9, 1e9, 10**400])
def test_absurd_number_is_refused_with_name_and_range(section, name, rule, wrong):
    error = refused(lambda: section(**{name: wrong}), setting=name, allowed=(rule.low, rule.high))
    assert f"{rule.high:g}" in error.advice


@pytest.mark.parametrize(("section", "name"), NUMBERS_BY_NAME)
@pytest.mark.parametrize("wrong", ["8", True, [8], 8j])
def test_what_is_no_number_is_refused(section, name, wrong):
    refused(lambda: section(**{name: wrong}), setting=name, value=repr(wrong))


@pytest.mark.parametrize(("section", "name", "rule"), NUMBERS)
def test_bounds_are_allowed_and_the_next_number_is_not(section, name, rule):
    for bound, beyond in ((rule.low, -math.inf), (rule.high, math.inf)):
        assert getattr(section(**{name: bound}), name) == bound
        with pytest.raises(ConfigError):
            section(**{name: math.nextafter(bound, beyond)})


@pytest.mark.parametrize("wrong", ["", " ", 3, True])
def test_what_is_no_file_name_is_refused(wrong):
    refused(lambda: TubeSettings(surface=wrong), setting="surface", value=repr(wrong))


@pytest.mark.parametrize("name", ["cycles", "resolution"])
def test_whole_number_takes_no_fraction(name):
    assert getattr(WaveSettings(**{name: 24.0}), name) == 24
    refused(lambda: WaveSettings(**{name: 24.5}), setting=name, value=24.5)


def test_numpy_numbers_become_plain_ones():
    section = TubeSettings(inner_diameter_mm=np.float32(8), length_cm=np.int64(50))
    assert type(section.inner_diameter_mm) is float
    assert section.length_cm == 50


@pytest.mark.parametrize(("section", "name", "rule"), CHOICES)
@pytest.mark.parametrize("wrong", ["glued", "", None, 1, ["held"]])
def test_unknown_choice_is_refused_with_the_choices(section, name, rule, wrong):
    refused(lambda: section(**{name: wrong}), setting=name, allowed=rule.options)


def test_stiffness_is_hardness_or_modulus_but_not_both():
    stiff = TubeSettings(shear_modulus_mpa=0.4)
    assert stiff.shore_a is None
    assert not hasattr(stiff, "hardness_shore_a")  # nothing else states the default hardness
    refused(lambda: TubeSettings(shear_modulus_mpa=0.4, shore_a=35), advice="give one of the two")


def test_depth_past_the_floor_says_how_deep_is_allowed():
    refused(lambda: load_config(depth_mm=12), setting="depth_mm", value=12, allowed=(0.05, 8.7))


def test_only_a_sweep_includes_the_untouched_tube():
    assert load_config(depth_mm=0).indentation.depth_mm == 0
    for refuse in (lambda: load_config(None, Mechanics, depth_mm=0), lambda: simulate(Config(
        indentation=IndentationSettings(depth_mm=0)
    ))):  # fmt: skip
        refused(refuse, setting="depth_mm", value=0)
    error = refused(lambda: load_config(depth_mm=0.01), setting="depth_mm", value=0.01)
    assert error.advice == "use 0.05 or more"


@pytest.mark.parametrize(
    ("height", "method", "warns"),
    [(0.5e-3, "full", True), (1.2e-3, "full", False), (0.5e-3, "spectral", False)],
)
def test_sound_of_a_closing_lumen_is_computed_with_a_warning(monkeypatch, height, method, warns):
    """By the height of the lumen: a soft ground sinks too. The spectral solver has no cells."""
    settings = settings_in_si(load_config(depth_mm=8, method=method))
    monkeypatch.setattr(
        simulation, "measure", lambda *_: SimpleNamespace(height=np.array([height]))
    )
    press = SimpleNamespace(indenters=[SimpleNamespace(z=0.0)])
    words = "walls of the 7.9 mm lumen meet, or nearly"
    assert any(words in one for one in simulation._narrow(settings, press)) == warns


def test_press_alone_may_close_the_lumen():
    """Depths up to 8.7 mm are allowed: half a wall beyond the bore, where the tube is solid."""
    assert load_config(None, Mechanics, depth_mm=8.7).indentation.depth_mm == 8.7
    for wrong in (8.71, 12):
        refused(
            lambda wrong=wrong: load_config(None, Mechanics, depth_mm=wrong),
            setting="depth_mm", value=wrong, allowed=(0.05, 8.7),
        )  # fmt: skip


def test_press_alone_needs_no_sound(tmp_path):
    """Sections without use for a press are ignored, but misspelt names in them are refused."""
    path = tmp_path / "a.toml"
    path.write_text("[waves]\nresolution = 1\n[indentation]\ndepth_mm = 8\n")
    assert load_config(path, Mechanics).indentation.depth_mm == 8
    path.write_text("[waves]\nresolutoin = 1\n")
    with pytest.raises(ConfigError, match="did you mean resolution"):
        load_config(path, Mechanics)


@pytest.mark.parametrize("kind", [Config, Mechanics])
@pytest.mark.parametrize(
    ("settings", "fields"),
    [
        ({"shape": "sphere", "yaw_deg": 10}, {"setting": "yaw_deg", "value": 10}),
        ({"offset_mm": 1}, {"setting": "offset_mm", "value": 1}),
        ({"layer_mm": 5, "support": "free"}, {"advice": "give both or neither"}),
        ({"layer_mpa": 5, "support": "free"}, {"advice": "give both or neither"}),
        ({"layer_mm": 5, "layer_mpa": 0.1}, {"setting": "layer_mm", "value": 5}),
    ],
)
def test_contradictions_of_the_press_are_refused(kind, settings, fields):
    refused(lambda: load_config(None, kind, **settings), **fields)


@pytest.mark.parametrize("kind", [Config, Mechanics])
@pytest.mark.parametrize(("shape", "diameter"), [("sphere", 5), ("sphere", 40), ("punch", 5)])
def test_largest_offset_is_that_at_which_first_touch_is_found(shape, diameter, kind):
    """On a circle of 4000 points, 1e-3 mm within the tube's, the search for it says the same."""
    angle = np.linspace(0, 2 * np.pi, 4001)
    circle = 5.55e-3 * np.stack([np.sin(angle), np.cos(angle), 0 * angle], axis=1)

    def beside(offset):
        return load_config(
            None, kind, shape=shape, indenter_mm=diameter, depth_mm=0.05, offset_mm=offset
        )

    error = refused(lambda: beside(-40), setting="offset_mm", value=-40)
    _, bound = error.allowed
    for offset, expected in (
        (bound - 0.1, nullcontext()),
        (bound + 0.02, pytest.raises(ConfigError, match="misses")),
    ):
        indenter = Indenter(shape=shape, diameter=diameter * 1e-3, x=offset * 1e-3)
        with expected:
            touch_height(circle, indenter.gap())
        with expected:
            beside(offset)


def test_an_indenter_that_would_reach_the_floor_beside_the_tube_is_refused():
    """A 5 mm punch with its edge 0.25 mm, 8 mm beside the axis, touches sqrt(5.8^2 - 5.75^2) up.

    The floor is then 0.76 - 0.25 + 5.55 = 6.06 mm below its lowest point; a layer adds to it.
    """
    beside = {"shape": "punch", "indenter_mm": 5, "offset_mm": 8, "support": "free"}
    load_config(None, Mechanics, depth_mm=6.05, **beside)
    refused(lambda: load_config(None, Mechanics, depth_mm=6.07, **beside), setting="depth_mm")
    load_config(None, Mechanics, depth_mm=6.07, layer_mm=1, layer_mpa=1, **beside)


def test_written_press_reads_back_equal(tmp_path):
    asked = load_config(
        None,
        Mechanics,
        surface='a "b".stl',
        shape="punch",
        offset_mm=-1.5,
        steps=3,
        support="free",
        layer_mm=5,
        layer_mpa=0.1,
    )
    path = tmp_path / "a.toml"
    path.write_text(to_toml(asked))
    assert load_config(path, Mechanics) == asked


@pytest.mark.parametrize("name", ["tube 😀.stl", 'a "b"\\c\td\x7f.stl', "Rohr # = 1.stl"])
def test_any_name_of_a_surface_survives_the_written_settings(name, tmp_path):
    asked = load_config(None, Mechanics, surface=str(tmp_path / name))
    path = tmp_path / "config.toml"
    path.write_text(to_toml(asked), encoding="utf-8")
    assert load_config(path, Mechanics) == asked


def test_name_that_no_text_file_can_hold_is_refused():
    refused(lambda: load_config(None, Mechanics, surface="tube \udcff.stl"), setting="surface")


def test_imported_wall_has_a_mesh_of_its_own():
    error = refused(
        lambda: load_config(None, Mechanics, surface="d.stl", mesh="coarse"),
        setting="mesh", value="coarse",
    )  # fmt: skip
    assert error.advice == "use mesh usual"


def test_surface_cannot_be_simulated_with_sound():
    error = refused(lambda: load_config(surface="d.stl"), setting="surface")
    assert "acoustube indent" in error.advice


def test_pressed_part_stays_between_probe_and_far_end():
    assert pressed_reach(11.1, 25) == pytest.approx(56.9)
    for allowed in (8.25, 33.75):  # half an outer diameter more
        assert load_config(position_cm=allowed).indentation.position_cm == allowed
    for wrong in (8.2, 33.8):
        refused(
            lambda wrong=wrong: load_config(position_cm=wrong),
            setting="position_cm", value=wrong, allowed=(8.25, 33.75),
        )  # fmt: skip


@pytest.mark.parametrize("method", ["scattering", "spectral"])
def test_part_computed_alone_stays_between_probe_and_far_end(method):
    """It is longer by three quarters of an outer diameter on each side."""
    for allowed in (9.08, 32.92):
        assert load_config(position_cm=allowed, method=method).position_cm == allowed
    for wrong in (9.0, 33.0):
        refused(
            lambda wrong=wrong: load_config(position_cm=wrong, method=method),
            setting="position_cm", value=wrong, allowed=(9.08, 32.92),
        )  # fmt: skip


def test_press_is_in_the_middle_unless_placed():
    assert load_config(length_cm=60).indentation.position_cm == 30
    assert load_config(length_cm=60, position_cm=20).indentation.position_cm == 20


def test_listening_plane_lies_beyond_the_first_cells():
    refused(
        lambda: load_config(probe_cm=0.1, inner_diameter_mm=10, resolution=8, frequency_khz=20),
        setting="probe_cm", value=0.1, allowed=(0.13, math.inf),
    )  # fmt: skip


def test_tube_too_short_for_any_press_says_how_long():
    refused(
        lambda: load_config(length_cm=12, position_cm=6),
        setting="length_cm", value=12, allowed=(14.5, math.inf),
    )  # fmt: skip
    load_config(length_cm=14.5, position_cm=8.25)


def test_grid_carries_eight_cells_per_wavelength():
    # 343.2 m/s / 42 kHz = 8.17 mm; 8 x 7.9 / 8.17 = 7.73. A 20 mm bore needs 19.6.
    load_config(resolution=8)
    wide = TubeSettings(inner_diameter_mm=20)
    refused(
        lambda: Config(tube=wide, waves=WaveSettings(resolution=19)),
        setting="resolution", value=19, allowed=(20, math.inf),
    )  # fmt: skip


def test_grid_that_no_computer_holds_is_refused_with_one_it_does():
    refused(
        lambda: load_config(resolution=200, length_cm=1000),
        setting="resolution", value=200, allowed=(8, 34),
    )  # fmt: skip
    load_config(resolution=34, length_cm=1000)


def test_lowpass_stays_an_octave_below_the_carrier():
    error = refused(
        lambda: load_config(frequency_khz=15, lowpass_khz=10), setting="lowpass_khz", value=10
    )
    assert error.allowed[1] == 7.5
    assert load_config(frequency_khz=15).signals.lowpass_khz == 7.5
    assert load_config(frequency_khz=42).signals.lowpass_khz == 10


def test_pulse_has_left_before_the_far_end_answers():
    """The sound takes 2.331 ms for 40 cm and back, the duration of 11.65 cycles of 5 kHz."""
    refused(
        lambda: load_config(frequency_khz=5, cycles=12),
        setting="cycles", value=12, allowed=(1, 11),
    )  # fmt: skip
    load_config(frequency_khz=5, cycles=11)


def test_tube_too_short_for_any_lowpass_is_named():
    error = refused(
        lambda: load_config(frequency_khz=5, length_cm=20, cycles=3), setting="length_cm"
    )
    assert error.advice == "use at least 20.6, or a higher frequency_khz"
    load_config(frequency_khz=5, length_cm=20.6, cycles=3)
    error = refused(
        lambda: load_config(frequency_khz=5.25, length_cm=19, cycles=3), setting="length_cm"
    )
    load_config(frequency_khz=5.25, length_cm=error.allowed[0], cycles=3)


def test_lowpass_is_faster_than_the_record():
    """The sound takes 2.33 ms for 40 cm and back, the duration of three periods of 1.29 kHz."""
    error = refused(lambda: load_config(lowpass_khz=1), setting="lowpass_khz", value=1)
    assert error.allowed[0] == 1.29
    load_config(lowpass_khz=1.29)


def test_flags_win_over_file_and_file_over_defaults(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text("[indentation]\nindenter_mm = 10\ndepth_mm = 3\n")
    config = load_config(path, depth_mm=2, position_cm=None)
    assert config.indentation.indenter_mm == 10
    assert config.indentation.depth_mm == 2
    assert config.indentation.position_cm == 20


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[waves]\nfrequncy_khz = 42", r"\[waves\] frequncy_khz .*did you mean frequency_khz\?"),
        ("[wave]\nfrequency_khz = 42", r"\[wave\] is not a section; did you mean waves\?"),
        ("[tube]\ndepth_mm = 2", r"depth_mm .*; it belongs under \[indentation\]"),
        ("depth_mm = 2", r"depth_mm stands outside a section; put it under \[indentation\]"),
        ("[qqq]\nx = 1", "known are tube, indentation, waves, signals"),
        ("[[tube]]\nwall_mm = 1", r"tube must be a section, written \[tube\]"),
        ("[tube\n", "is not valid TOML: "),
        ("[tube]\nwall_mm = 1\nwall_mm = 2", "is not valid TOML: "),
        ("[tube]\nwall_mm = nan", "^wall_mm = nan is out of range; use 0.2 to 20 mm"),
        ("[tube]\nwall_mm = 1" + 5000 * "0", "cannot be read"),
    ],
)
def test_wrong_file_is_refused_with_the_next_step(tmp_path, text, message):
    path = tmp_path / "a.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        load_config(path)


def test_missing_folder_or_binary_file_is_refused_by_name(tmp_path):
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe[tube]")
    for path, reason in (
        (tmp_path / "none.toml", "No such file"),
        (tmp_path, "is a folder, not a file"),
        (binary, "not a text file in UTF-8"),
        ("nul\0.toml", "null"),
    ):
        with pytest.raises(ConfigError, match=reason):
            load_config(path)


def test_unknown_override_names_the_nearest():
    with pytest.raises(ConfigError, match=r"depth is not a setting; did you mean depth_mm\?"):
        load_config(depth=3)


def _section(cls):
    """Draw values of all fields of a section within their rules."""
    rules = {field.name: field.metadata["rule"] for field in dataclasses.fields(cls)}
    return st.fixed_dictionaries({name: _value(rule) for name, rule in rules.items()})


def _value(rule):
    if isinstance(rule, Choice):
        return st.sampled_from(rule.options)
    if isinstance(rule, File):
        return st.none()
    if rule.whole:
        return st.integers(int(rule.low), int(rule.high))
    return st.floats(rule.low, rule.high)


# Only settings whose grids are too coarse or too large are skipped.
@settings(deadline=None, suppress_health_check=[HealthCheck.filter_too_much])
@given(
    tube=_section(TubeSettings),
    waves=_section(WaveSettings),
    rest=_section(SignalSettings),
    by_modulus=st.booleans(),
    share=st.floats(0.05, 1),
    along=st.floats(0, 1),
    indenter=st.floats(2, 100),
    support=st.sampled_from(["held", "free"]),
)
def test_written_configuration_reads_back_equal(
    tmp_path_factory, tube, waves, rest, by_modulus, share, along, indenter, support
):
    tube["shore_a" if by_modulus else "shear_modulus_mpa"] = None
    bore, outer = tube["inner_diameter_mm"], tube["inner_diameter_mm"] + 2 * tube["wall_mm"]
    clearance = CLEARANCE if waves["method"] == "full" else JOINED_CLEARANCE
    reach = (pressed_reach(outer, indenter) + clearance * outer) / 10
    waves["probe_cm"] = max(waves["probe_cm"], bore / waves["resolution"] / 10 + 0.01)
    tube["length_cm"] = max(tube["length_cm"], min(1000, waves["probe_cm"] + 2 * reach + 1))
    answer_ms = 20 * tube["length_cm"] / sound_speed(waves["temperature_c"])
    waves["cycles"] = max(1, min(waves["cycles"], int(answer_ms * waves["frequency_khz"])))
    slowest = 3 * sound_speed(waves["temperature_c"]) / 20 / tube["length_cm"] + 0.01
    assume(slowest < waves["frequency_khz"] / 2 - 0.01)
    rest["lowpass_khz"] = min(max(rest["lowpass_khz"], slowest), waves["frequency_khz"] / 2 - 0.01)
    first, last = waves["probe_cm"] + reach + 0.02, tube["length_cm"] - reach - 0.02
    try:
        config = Config(
            tube=TubeSettings(**tube),
            indentation=IndentationSettings(
                indenter_mm=indenter,
                depth_mm=max(0.05, share * (0.9 * bore - 0.02)),
                position_cm=first + along * (last - first),
                support=support,
            ),
            waves=WaveSettings(**waves),
            signals=SignalSettings(**rest),
        )
    except ConfigError as error:
        assume("resolution" not in str(error))
        raise
    path = tmp_path_factory.mktemp("toml") / "config.toml"
    path.write_text(to_toml(config), encoding="utf-8")
    assert load_config(path) == config


def test_documented_defaults_are_the_defaults():
    assert (ROOT / "docs" / "defaults.toml").read_text(encoding="utf-8") == to_toml(Config())


def test_every_shipped_tube_is_a_valid_configuration():
    meshes = ROOT / "meshes"
    tubes = sorted(meshes.glob("*.toml"))
    assert len(tubes) == 6
    for path in tubes:
        load_config(path)
    assert load_config(meshes / "paper_tube.toml") == Config()


def test_surface_is_found_from_the_folder_of_its_file(tmp_path, monkeypatch):
    """Names in a file are relative to its folder, names in an option to the current folder."""
    (tmp_path / "walls").mkdir()
    file = tmp_path / "walls" / "tube.toml"
    file.write_text('[tube]\nsurface = "wall.stl"\n')
    monkeypatch.chdir(tmp_path)
    assert load_config(file, Mechanics).tube.surface == str(tmp_path / "walls" / "wall.stl")
    given = load_config(None, Mechanics, surface="other.stl")
    assert given.tube.surface == str(tmp_path / "other.stl")


def test_errors_cross_processes_with_their_fields():
    """An error of a worker process reaches the command with all its fields."""
    error = refused(lambda: load_config(depth_mm=12), setting="depth_mm")
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == str(error)
    assert vars(again) == vars(error)
