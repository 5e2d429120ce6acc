"""Stress: axes walked one at a time, then random scenes, each held to the invariants.

A case that breaks one is shrunk: axes are left alone one after the other for as long as it still
breaks. What remains is written down as YAML and can be examined again.
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from scanrender.errors import ConfigError, UsageError
from scanrender.files import write_text
from scanrender.measure.extremes import AXES, SUBJECT, Case, case_of, random_case
from scanrender.measure.invariants import INVARIANTS, Finding, Refusal, examine
from scanrender.render.device import Device

Say = Callable[[str], None]
# Each random case is tested for soundness and for this many other invariants, in turn.
OTHERS_A_CASE = 2
SHOWN_EVERY_S = 20.0
# Axes of large pictures, which are only looked at, and by default in runs of so many minutes.
LARGE_AXES, LONG_MINUTES = ("frame_px",), 10.0


@dataclass(frozen=True)
class Examined:
    """One case and what one invariant said of it."""

    case: Case
    outcome: Finding | Refusal

    @property
    def is_broken(self) -> bool:
        return isinstance(self.outcome, Finding) and not self.outcome.holds


@dataclass(frozen=True)
class Broken:
    """A case that breaks an invariant, shrunk; where it was written; the number of its scene."""

    case: Case
    finding: Finding
    seed: int
    file: Path | None = None


@dataclass(frozen=True)
class Stress:
    """All that was examined: walks by axis and value, the random scenes, and what broke."""

    walks: Mapping[str, Sequence[tuple[Any, Sequence[Examined]]]]
    scenes: int
    seeds: tuple[int, int]
    tests: Sequence[Examined]
    broken: Sequence[Broken]
    seconds: float


def run_stress(
    device: Device,
    minutes: float,
    seed: int = 0,
    axes: Sequence[str] | None = None,
    out: Path | None = None,
    say: Say = lambda _: None,
) -> Stress:
    """Walk `axes` (default: all), then draw scenes `seed`, `seed + 1`, … for `minutes`.

    By default large pictures are walked in long runs alone. Cases that break an invariant are
    written to `out` where it is given. Raises UsageError.
    """
    known = [name for name in (*AXES, *SUBJECT) if _axis(name).walk]
    if unknown := set(axes or ()) - set(known):
        raise UsageError(f"no axis is walked that is called {min(unknown)}", fix=", ".join(known))
    walks = {}
    usual = [n for n in known if n not in LARGE_AXES or minutes >= LONG_MINUTES]
    for name in usual if axes is None else axes:
        walks[name] = walk(device, name)
        bad = sum(e.is_broken for _, examined in walks[name] for e in examined)
        say(f"axis {name}: {len(walks[name])} values, {bad} broken")
    started = time.perf_counter()
    tests: list[Examined] = []
    broken: list[Broken] = []
    number, told = seed, started
    while time.perf_counter() - started < 60.0 * minutes:
        for examined in examine_scene(device, random_case(number), number):
            tests.append(examined)
            if examined.is_broken:
                broken.append(_shrunk(device, examined, number, out))
                say(f"scene {number}: {in_words(broken[-1].finding)}; {broken[-1].case.axes}")
        number += 1
        if time.perf_counter() - told > SHOWN_EVERY_S:
            told = time.perf_counter()
            say(f"{number - seed} scenes, {len(tests)} tests, {len(broken)} broken")
    seconds = time.perf_counter() - started
    return Stress(walks, number - seed, (seed, number - 1), tests, broken, seconds)


def walk(device: Device, name: str) -> list[tuple[Any, list[Examined]]]:
    """Every invariant at each of an axis' values, all else plain; of a large picture that it is
    sound."""
    found = []
    for value in _axis(name).walk:
        case = case_of({name: value})
        names = ["sound"] if name in LARGE_AXES else list(INVARIANTS)
        outcomes = ((case, outcome_of(device, case, invariant)) for invariant in names)
        found.append((value, [Examined(c, o) for c, o in outcomes if o is not None]))
    return found


def examine_scene(device: Device, case: Case, number: int) -> list[Examined]:
    """Soundness, and if the scene can be rendered, some of the other invariants."""
    first = outcome_of(device, case, "sound")
    assert first is not None
    found = [Examined(case, first)]
    if isinstance(first, Refusal) or not first.holds:
        return found
    others = [name for name in INVARIANTS if name != "sound"]
    for step in range(OTHERS_A_CASE):
        outcome = outcome_of(device, case, others[(OTHERS_A_CASE * number + step) % len(others)])
        if outcome is not None:
            found.append(Examined(case, outcome))
    return found


def shrink(device: Device, case: Case, invariant: str) -> tuple[Case, Finding]:
    """The case with as few axes moved as still break `invariant`."""
    finding = outcome_of(device, case, invariant)
    assert isinstance(finding, Finding)
    for name in case.axes:
        simpler = case.without(name)
        outcome = outcome_of(device, simpler, invariant)
        if isinstance(outcome, Finding) and not outcome.holds:
            case, finding = simpler, outcome
    return case, finding


def save_case(file: Path, case: Case, finding: Finding) -> Path:
    """A case as YAML: the axes that make it, and for people the settings that they come to."""
    document = {
        "invariant": finding.invariant,
        "found": in_words(finding),
        "axes": dict(case.axes),
        "settings": case.settings,
    }
    stream = io.StringIO()
    YAML(typ="safe", pure=True).dump(document, stream)
    return write_text(file, stream.getvalue())


def load_case(file: Path) -> tuple[Case, str]:
    """A saved case and the invariant that it broke. Raises UsageError, ConfigError."""
    if not file.is_file():
        raise UsageError(f"no such case: {file}")
    try:
        document = YAML(typ="safe", pure=True).load(file.read_text(encoding="utf-8"))
        axes, invariant = dict(document["axes"]), str(document["invariant"])
        unknown = [name for name in axes if name not in (*AXES, *SUBJECT)]
        if invariant not in INVARIANTS or unknown:
            raise ValueError(f"it names {', '.join(unknown) or invariant!r}, which nobody knows")
        return case_of(axes), invariant
    except (YAMLError, KeyError, TypeError, ValueError, OSError) as error:
        raise ConfigError(f"this is no case of scanrender stress: {error}", str(file)) from error


def in_words(finding: Finding) -> str:
    figures = f"{finding.figure:.3g}, bound {finding.bound:g}"
    return f"{finding.invariant}: {figures} {finding.sentence}".rstrip()


def _axis(name: str) -> Any:
    return AXES[name] if name in AXES else SUBJECT[name]


def outcome_of(device: Device, case: Case, invariant: str) -> Finding | Refusal | None:
    """Of settings that are out of bounds: that they are refused, and why."""
    try:
        case.pipeline()
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        return Refusal(f"{where}: {first['msg']}")
    return examine(device, case, invariant)


def _shrunk(device: Device, examined: Examined, number: int, out: Path | None) -> Broken:
    assert isinstance(examined.outcome, Finding)
    case, finding = shrink(device, examined.case, examined.outcome.invariant)
    file = None
    if out is not None:
        name = finding.invariant.replace(" ", "_")
        file = save_case(out / f"scene_{number}_{name}.yaml", case, finding)
    return Broken(case, finding, number, file)
