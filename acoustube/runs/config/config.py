"""All settings of a press and of a simulation."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, TypeVar

from acoustube.base.errors import ConfigError
from acoustube.runs.config.checks import (
    check_depth,
    check_lowpass,
    check_offset,
    check_position,
    check_press,
    check_probe,
    check_pulse,
    check_resolution,
    check_round,
    check_touched,
    usual_lowpass,
)
from acoustube.runs.config.settings import (
    IndentationSettings,
    SignalSettings,
    TubeSettings,
    WaveSettings,
)


@dataclass(frozen=True, kw_only=True)
class Mechanics:
    """Settings of a press alone, which may close the lumen.

    Parameters
    ----------
    tube, indentation : section
        The sections; each is checked on its own before they are checked together.

    Raises
    ------
    ConfigError
        If a section is not of its class, settings of the press contradict each other, the depth is
        0 or outside the model's range, the indenter misses the tube, or an imported wall has
        another mesh than ``usual``.
    """

    tube: TubeSettings = dataclasses.field(default_factory=TubeSettings)
    indentation: IndentationSettings = dataclasses.field(default_factory=IndentationSettings)

    def __post_init__(self) -> None:
        _check_sections(self)
        check_press(self.indentation)
        check_touched(self.indentation)
        if self.tube.surface is None:
            check_depth(self.tube, self.indentation)
            check_offset(self.tube, self.indentation)
        elif self.indentation.mesh != "usual":  # the depth is checked when the surface is read
            raise ConfigError(
                f"applies to round tubes, not to surface = {self.tube.surface}",
                setting="mesh", value=self.indentation.mesh, advice="use mesh usual",
            )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Config:
    """All settings of one simulation.

    Parameters
    ----------
    tube, indentation, waves, signals : section
        The sections; each is checked on its own before the checks across sections are made here.

    Raises
    ------
    ConfigError
        If a section is not of its class, or the sections contradict each other: an imported wall,
        a depth outside the model's range, an indenter that misses the tube, a press too near an
        end, a grid that is too coarse for the sound or too large, a pulse longer than the round
        trip, or an unsuitable low-pass.

    Notes
    -----
    A depth of zero is the untouched tube, which a sweep may include.
    """

    tube: TubeSettings = dataclasses.field(default_factory=TubeSettings)
    indentation: IndentationSettings = dataclasses.field(default_factory=IndentationSettings)
    waves: WaveSettings = dataclasses.field(default_factory=WaveSettings)
    signals: SignalSettings = dataclasses.field(default_factory=SignalSettings)

    def __post_init__(self) -> None:
        _check_sections(self)
        check_press(self.indentation)
        check_round(self.tube)
        self._fill("indentation", "position_cm", self.position_cm)
        self._fill("signals", "lowpass_khz", self.lowpass_khz)
        check_depth(self.tube, self.indentation)
        check_offset(self.tube, self.indentation)
        indenter = self.indentation.indenter_mm
        check_position(self.tube, indenter, self.position_cm, self.waves)
        check_resolution(self.tube, indenter, self.waves)
        check_probe(self.tube, self.waves)
        check_pulse(self.tube, self.waves)
        check_lowpass(self.tube, self.waves, self.lowpass_khz)

    @property
    def position_cm(self) -> float:
        """Distance of the press from the source end in cm; half the tube's length by default."""
        given = self.indentation.position_cm
        return self.tube.length_cm / 2 if given is None else given

    @property
    def lowpass_khz(self) -> float:
        """Cut-off of the envelope's low-pass in kHz; by default half the carrier, at most 10."""
        given = self.signals.lowpass_khz
        return usual_lowpass(self.waves) if given is None else given

    def _fill(self, section: str, name: str, value: float) -> None:
        """Replace a setting that is None by `value`, its default derived from other settings."""
        settings = getattr(self, section)
        if getattr(settings, name) is None:
            object.__setattr__(self, section, dataclasses.replace(settings, **{name: value}))


def _check_sections(config: Any) -> None:
    """Raise if a section is not of its class."""
    for field in dataclasses.fields(config):
        value, section = getattr(config, field.name), SECTIONS[field.name]
        if not isinstance(value, section):
            raise ConfigError(f"{field.name} = {value!r} must be a {section.__name__}")


SECTIONS: dict[str, type[Any]] = {
    "tube": TubeSettings,
    "indentation": IndentationSettings,
    "waves": WaveSettings,
    "signals": SignalSettings,
}
"""Classes of the sections of settings, by name of the section."""


Settings = TypeVar("Settings", Config, Mechanics)
