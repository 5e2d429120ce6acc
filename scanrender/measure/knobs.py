"""What a user can trade: every setting that buys time with accuracy, declared once.

A knob that is added here joins the study, its tables and its sentences.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import Any

Settings = Mapping[str, Any]

BLURS = ("gaussian_sum", "separable_preintegrated", "separable_artistic")
SCREEN = (*BLURS, "disk")


@dataclass(frozen=True)
class Knob:
    """`key` of the pipeline, its `usual` value, the `others`, and the methods that have it.

    With `crossed` it is combined with every other crossed knob; else it is turned alone, `along`
    with settings without which it does nothing.
    """

    key: str
    usual: Any
    others: tuple[Any, ...]
    methods: tuple[str, ...]
    crossed: bool = False
    along: Settings = field(default_factory=dict)

    @property
    def values(self) -> tuple[Any, ...]:
        return (self.usual, *self.others)


KNOBS = (
    Knob("diffusion.samples", 17, (9, 33), BLURS, crossed=True),
    Knob("diffusion.halo", "measure", ("none", "depth", "cbf", "cbf_normalized"), BLURS,
         crossed=True),
    Knob("diffusion.disk_taps", 64, (16, 32, 256), ("disk",)),
    Knob("diffusion.limit", "none", ("lab",), SCREEN),
    Knob("diffusion.jitter", False, (True,), SCREEN),
    Knob("curvature.modulation", "none", ("reduce", "reduce_to_minimum", "increase"), SCREEN),
    Knob("diffusion.gaussians", 255, (3, 4), ("gaussian_sum",)),
    Knob("diffusion.resolution", "full", ("half",), SCREEN),
    Knob("quality.precision", "full", ("half",), SCREEN),
    Knob("quality.supersampling", 1, (2,), ("none", *SCREEN)),
    Knob("quality.sampling", "everywhere", ("contrast",), ("none", *SCREEN),
         along={"quality.supersampling": 2}),
)  # fmt: skip
METHOD = "diffusion.method"


def points() -> list[dict[str, Any]]:
    """Every point of the study: the settings that it has, the method first; none twice."""
    found = [dict(point) for method in ("none", *SCREEN) for point in _points_of(method)]
    unique = {name_of(point): point for point in found}
    return list(unique.values())


def _points_of(method: str) -> Iterator[Settings]:
    mine = [knob for knob in KNOBS if method in knob.methods]
    usual = {METHOD: method, **{knob.key: knob.usual for knob in mine}}
    crossed = [knob for knob in mine if knob.crossed]
    for values in product(*(knob.values for knob in crossed)):
        yield {**usual, **{knob.key: v for knob, v in zip(crossed, values, strict=True)}}
    for knob in mine:
        if not knob.crossed:
            yield from ({**usual, **knob.along, knob.key: value} for value in knob.values)


def name_of(point: Settings) -> str:
    """The method, and what is not as usual: `disk, disk_taps 16`."""
    usual = {knob.key: knob.usual for knob in KNOBS}
    odd = [f"{key.split('.')[1]} {v}" for key, v in point.items()
           if key != METHOD and v != usual[key]]  # fmt: skip
    return ", ".join([str(point[METHOD]), *odd])


def overrides(point: Settings) -> tuple[str, ...]:
    """The point as `--set` would say it."""
    said = {True: "true", False: "false"}
    return tuple(
        f"{key}={said.get(v, v) if isinstance(v, bool) else v}" for key, v in point.items()
    )


def twins(rows: list[Mapping[str, Any]], knob: Knob, value: Any) -> list[tuple[Any, Any]]:
    """(row with the usual value, row with `value`) that differ in this knob alone."""
    by_point = {frozenset(row["point"].items()): row for row in rows}
    pairs = []
    for row in rows:
        if row["point"].get(knob.key) == value:
            usual = by_point.get(frozenset({**row["point"], knob.key: knob.usual}.items()))
            if usual is not None:
                pairs.append((usual, row))
    return pairs
