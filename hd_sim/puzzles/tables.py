"""Tables of a campaign: shares with exact intervals and quantiles, from the records of single joints."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

FAILED = "failed"
"""Verdict of a diagnosis that ended in an error."""
CLEAR_GAIN = 200.0
"""nats that the true effect gains on data that were not used for its fit."""
COVERED = "parameter inside its 95 % interval"
COVERED_SAME = "parameter inside its 95 % interval, same law in world and library"
CLEAR = f"oracle gain {CLEAR_GAIN:g} nats or more"
Record = Mapping[str, Any]
Answer = Callable[[Record], bool | None]


@dataclass(frozen=True)
class Row:
    """One line: a share `hits` of `count` with its exact 95 % interval, or a number (`value`) from `count` ones."""

    name: str
    count: int
    hits: int | None = None
    low: float | None = None
    high: float | None = None
    value: float | None = None
    unit: str = ""

    @property
    def share(self) -> float | None:
        """hits / count."""
        return None if self.hits is None or not self.count else self.hits / self.count

    def to_dict(self) -> dict[str, Any]:
        """Plain types."""
        return asdict(self) | {"share": self.share}


def interval(hits: int, count: int) -> tuple[float, float]:
    """Exact 95 % interval of a share (Clopper and Pearson, 1934); (0, 1) for nothing counted."""
    from scipy.stats import beta

    tail = 0.025
    low = float(beta.ppf(tail, hits, count - hits + 1)) if hits else 0.0
    high = float(beta.ppf(1.0 - tail, hits + 1, count - hits)) if hits < count else 1.0
    return low, high


def make_table(records: Sequence[Record]) -> list[Row]:
    """The rows: no effect, one, two, unknown, poor recordings. Rows without a single case are left out."""
    parts = {name: [r for r in records if r["category"] == name] for name in ("none", "one", "two", "unknown", "poor")}
    none, one, two, unknown, poor = parts.values()
    good = [*none, *one, *two, *unknown]
    rows = [
        _share("no effect: false alarm", none, _flag("false_alarm")),
        _share("no effect: a name claimed", none, lambda r: bool(r["score"]["wrong"])),
        *_one_effect_rows(one),
        *_two_effects_rows(two),
        _share("unknown: flagged", unknown, _flag("unknown_flagged")),
        _share("unknown: right variable", unknown, _flag("unknown_variable")),
        _share("unknown: right channel", unknown, _flag("unknown_channel")),
        _share("unknown: no wrong name", unknown, lambda r: not r["score"]["wrong"]),
        _share("poor recording: wrong confident claim", poor, _flag("confident_wrong")),
        _share("poor recording: refused", poor, _flag("refused")),
        _share("poor recording: refused, right after a general one", _asked_again(poor), lambda r: r["correct"]),
        _share("good recording: needless refusal", good, _flag("refused")),
        _share("diagnosis failed", records, lambda r: r["score"]["verdict"] == FAILED),
        *_confidence_rows(good),
        _share("control: one effect, top 1 against another joint's truth", _shuffled(one), lambda r: r["hit"]),
        *_parameter_rows(records),
        *_held_out_rows(good),
        *_time_rows(records),
    ]
    return [row for row in rows if row.count]


def _one_effect_rows(one: Sequence[Record]) -> list[Row]:
    steps = [
        (f"one effect, {step}: top 1", _step(one, step)) for step in ("weak", "faint", "middle", "strong", "clear")
    ]
    clean = [(f"one effect, {s}: exact, nothing extra", _step(one, s)) for s in ("middle", "strong", "clear")]
    return [
        _share("one effect: top 1", one, _flag("top_1")),
        *(_share(name, found, _flag("top_1")) for name, found in steps),
        _share("one effect: right name or its group", one, _flag("group")),
        _share("one effect: exact", one, _flag("exact")),
        _share("one effect: exact, nothing extra", one, _flag("clean")),
        *(_share(name, found, _flag("clean")) for name, found in clean),
        _share(f"one effect, {CLEAR}: top 1", _clear(one), _flag("top_1")),
        _share(f"one effect, {CLEAR}: exact, nothing extra", _clear(one), _flag("clean")),
    ]


def _two_effects_rows(two: Sequence[Record]) -> list[Row]:
    return [
        _share("two effects: both named", two, lambda r: not r["score"]["missed"]),
        _share("two effects: exact", two, _flag("exact")),
        _share("two effects: exact, nothing extra", two, _flag("clean")),
        _share(f"two effects, {CLEAR}: both named", _clear(two), lambda r: not r["score"]["missed"]),
        _share(f"two effects, {CLEAR}: exact", _clear(two), _flag("exact")),
    ]


def _asked_again(records: Iterable[Record]) -> list[Record]:
    """Scores after the judge has played the experiment."""
    return [r["score_after_experiment"] for r in records if r.get("score_after_experiment")]


def _clear(records: Iterable[Record]) -> list[Record]:
    """Those in which every hidden effect leaves a clear trace."""
    return [record for record in records if (record.get("oracle_gain") or 0.0) >= CLEAR_GAIN]


def _flag(name: str) -> Answer:
    return lambda record: record["score"][name]


def _step(records: Iterable[Record], step: str) -> list[Record]:
    return [record for record in records if record["step"] == step]


def _share(name: str, records: Iterable[Record], answer: Answer) -> Row:
    answers = [value for value in map(answer, records) if value is not None]
    hits = sum(map(bool, answers))
    low, high = interval(hits, len(answers))
    return Row(name, len(answers), hits, low, high)


def _quantile(name: str, values: Sequence[float], level: float, unit: str) -> Row:
    return Row(name, len(values), value=float(np.quantile(values, level)) if values else None, unit=unit)


def _parameter_rows(records: Sequence[Record]) -> list[Row]:
    found = [p for r in records if r["category"] in ("one", "two") for p in r["score"]["parameters"]]
    errors = [100.0 * p["relative_error"] for p in found if np.isfinite(p["relative_error"])]
    covered = [{"covered": p["covered"]} for p in found]
    same = [
        {"covered": p["covered"]}
        for r in records
        if r["category"] in ("one", "two")
        for p in r["score"]["parameters"]
        if p["effect"] in r.get("same_law", r["names"])
    ]
    return [
        _quantile("parameter error, median", errors, 0.5, "%"),
        _quantile("parameter error, 90 % quantile", errors, 0.9, "%"),
        _share(COVERED, covered, lambda p: p["covered"]),
        _share(COVERED_SAME, same, lambda p: p["covered"]),
    ]


def _confidence_rows(records: Iterable[Record]) -> list[Row]:
    """How far stated confidence and share of right names are apart: mean over ten bins, weighted by their counts."""
    said = []
    for record in records:
        for effect in record["answer"].get("effects") or []:
            if effect["name"] not in record["score"]["tolerated"]:
                said.append((float(effect.get("confidence") or 0.0), effect["name"] in record["names"]))
    if not said:
        return []
    confidence, right = np.array(said, dtype=float).T
    bins = np.minimum((10.0 * confidence).astype(int), 9)
    weights = np.bincount(bins, minlength=10)
    gaps = np.abs(np.bincount(bins, confidence, 10) - np.bincount(bins, right, 10))
    return [
        _share("named effects: right", [{"right": value} for value in right], lambda r: bool(r["right"])),
        Row("calibration error of the confidence", len(said), value=float(gaps.sum() / weights.sum())),
    ]


def _shuffled(records: Sequence[Record]) -> list[dict[str, bool]]:
    """Label permutation: every answer against the truth of the next joint; the score must fall to chance."""
    found = []
    for answered, other in zip(records, [*records[1:], *records[:1]], strict=True):
        named = [effect["name"] for effect in answered["answer"].get("effects") or []]
        found.append({"hit": bool(named) and named[0] == other["names"][0]})
    return found


def _held_out_rows(records: Iterable[Record]) -> list[Row]:
    shares = [r["held_out_share"] for r in records if r.get("held_out_share") is not None]
    wins = [{"well": share >= 0.97} for share in shares]
    return [
        _quantile("held-out reduction over the oracle's, median", shares, 0.5, ""),
        _share("held-out reduction at least 97 % of the oracle's", wins, lambda r: r["well"]),
    ]


def _time_rows(records: Iterable[Record]) -> list[Row]:
    seconds = [r["cpu_seconds"] for r in records if r.get("cpu_seconds") is not None]
    return [
        _quantile("computing time, median", seconds, 0.5, "s CPU"),
        _quantile("computing time, 95 % quantile", seconds, 0.95, "s CPU"),
    ]


def confusion(records: Iterable[Record]) -> list[tuple[str, str, int]]:
    """Hidden effect, answer, count, for recordings of one effect; the answer is the first name or the verdict."""
    counts: dict[tuple[str, str], int] = {}
    for record in records:
        if record["category"] == "one":
            score = record["score"]
            first = record["answer"]["effects"][0]["name"] if record["answer"].get("effects") else score["verdict"]
            key = (record["names"][0], first)
            counts[key] = counts.get(key, 0) + 1
    return sorted(((a, b, n) for (a, b), n in counts.items()), key=lambda entry: (entry[0], -entry[2], entry[1]))


def table_text(rows: Iterable[Row]) -> str:
    """The rows as a table for people, in Markdown."""
    lines = ["| figure | count | value | 95 % interval |", "|---|---|---|---|"]
    for row in rows:
        if row.share is None:
            value = "–" if row.value is None else f"{row.value:.3g} {row.unit}".strip()
            lines.append(f"| {row.name} | {row.count} | {value} | |")
        else:
            ends = f"{100 * (row.low or 0.0):.1f}–{100 * (row.high or 0.0):.1f} %"
            lines.append(f"| {row.name} | {row.hits}/{row.count} | {100 * row.share:.1f} % | {ends} |")
    return "\n".join(lines)


# ---- Worlds side by side ---------------------------------------------------------------------------


FAINT_STEPS, CLEAR_STEPS = ("weak", "faint"), ("strong", "clear")
"""How clearly the hidden effect shows, in the words of either world."""
TARGETS: Mapping[str, tuple[float, bool]] = {
    "nothing missing: false alarm": (0.02, False),
    "one effect: right first": (0.95, True),
    "one effect: exact set": (0.90, True),
    "two effects: both named": (0.90, True),
    "two effects: exact set": (0.85, True),
    "unknown: flagged": (0.95, True),
    "unknown: right variable": (0.90, True),
    COVERED: (0.90, True),
    COVERED_SAME: (0.90, True),
    "poor recording: wrong confident claim": (0.03, False),
    "calibration error of the confidence": (0.05, False),
    "one effect, barely visible: right first": (0.0, True),
    "one effect, clear: right first": (0.0, True),
}
"""Figure -> what it should reach in the worse world, and whether more is better; 0: only compared with its like."""


def headline_rows(records: Sequence[Record]) -> dict[str, Row]:
    """The figures of `TARGETS` for one world; those without a case have the count 0."""
    none, one, two, unknown, poor = (
        [r for r in records if r["category"] == name] for name in ("none", "one", "two", "unknown", "poor")
    )
    good = [*none, *one, *two, *unknown]
    faint, clear = ([r for r in one if r["step"] in steps] for steps in (FAINT_STEPS, CLEAR_STEPS))
    rows = [
        _share("nothing missing: false alarm", none, _flag("false_alarm")),
        _share("one effect: right first", one, _flag("top_1")),
        _share("one effect: exact set", one, _flag("exact")),
        _share("two effects: both named", two, lambda r: not r["score"]["missed"]),
        _share("two effects: exact set", two, _flag("exact")),
        _share("unknown: flagged", unknown, _flag("unknown_flagged")),
        _share("unknown: right variable", unknown, _flag("unknown_variable")),
        *_parameter_rows(records)[2:],
        _share("poor recording: wrong confident claim", poor, _flag("confident_wrong")),
        *_confidence_rows(good)[1:],
        _share("one effect, barely visible: right first", faint, _flag("top_1")),
        _share("one effect, clear: right first", clear, _flag("top_1")),
    ]
    found = {row.name: row for row in rows}
    return {name: found.get(name, Row(name, 0)) for name in TARGETS}


def worse_world(name: str, rows: Mapping[str, Row]) -> str | None:
    """Which of the worlds, given with their rows of one figure, has the worse value; None if none was measured."""
    sizes = {world: row.value if row.share is None else row.share for world, row in rows.items()}
    measured = {world: size for world, size in sizes.items() if size is not None}
    if not measured:
        return None
    more_is_better = TARGETS[name][1]
    return (min if more_is_better else max)(measured, key=lambda world: measured[world])


def headline(records: Sequence[Record]) -> list[dict[str, Any]]:
    """Per figure: `name`, `target`, `worlds` (world -> row in plain types), `worse` (the world that counts)."""
    worlds = sorted({r.get("world", "home") for r in records})
    tables = {world: headline_rows([r for r in records if r.get("world", "home") == world]) for world in worlds}
    found = []
    for name, (target, _) in TARGETS.items():
        rows = {world: tables[world][name] for world in worlds}
        plain = {world: row.to_dict() for world, row in rows.items()}
        found.append({"name": name, "target": target or None, "worlds": plain, "worse": worse_world(name, rows)})
    return found


def headline_text(records: Sequence[Record]) -> str:
    """The headline as a table for people, in Markdown: one column per world, exact intervals, the worse world."""
    entries = headline(records)
    worlds = list(entries[0]["worlds"])
    lines = [f"| figure | {' | '.join(worlds)} | worse | target |", "|---" * (len(worlds) + 3) + "|"]
    for entry in entries:
        cells = [_cell(entry["worlds"][world]) for world in worlds]
        sign = "≥" if TARGETS[entry["name"]][1] else "≤"
        target = "–" if entry["target"] is None else f"{sign} {entry['target']:g}"
        lines.append(f"| {entry['name']} | {' | '.join(cells)} | {entry['worse'] or '–'} | {target} |")
    return "\n".join(lines)


def _cell(row: Mapping[str, Any]) -> str:
    if row["share"] is not None:
        ends = f"{100 * (row['low'] or 0.0):.0f}–{100 * (row['high'] or 0.0):.0f}"
        return f"{row['hits']}/{row['count']} = {100 * row['share']:.1f} % ({ends})"
    return "–" if row["value"] is None else f"{row['value']:.3f} ({row['count']})"


def _named_wrongly(record: Record) -> bool:
    return bool(record["score"]["wrong"])


def spoilt_rows(records: Sequence[Record]) -> list[Row]:
    """Real-like recordings: shares with a false name, on perfect models and altogether, by what was spoilt."""
    perfect = [r for r in records if r["category"] == "none"]
    answered = [r for r in perfect if not r["score"]["refused"]]
    rows = [
        _share("perfect model: false names", perfect, _named_wrongly),
        _share("perfect model, answered: false names", answered, _named_wrongly),
        _share("perfect model: wrong confident claim", perfect, _flag("confident_wrong")),
        _share("all: false names", records, _named_wrongly),
    ]
    for key in ("torque", "angle", "rate", "signals"):
        for value in sorted({r["features"][key] for r in perfect}, key=str):
            part = [r for r in perfect if r["features"][key] == value]
            rows.append(_share(f"perfect model, {key} {value}: false names", part, _named_wrongly))
    return [row for row in rows if row.count]
