"""A blind campaign: many random joints, each diagnosed without its truth, each answer scored afterwards.

One line of JSON per joint goes to the record file as soon as it is known, so an interrupted campaign loses nothing and
goes on where it stopped. The diagnosis receives columns and nominal values, never the case. The table of the records
has counts with exact intervals, and quantiles.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError, HdError
from hd_control.core.workers import serve_only
from hd_sim.puzzles.puzzle import REFUSED, score_joint
from hd_sim.puzzles.recordings import FIT_S, HELD_OUT_S, Pair, make_pair, set_up

if TYPE_CHECKING:
    from hd_control.drive.model import JointModel, Model
    from hd_control.lab.signals.joint_signals import Recording


# ---- The table, from the records of single challenges ----------------------------------------------


FAILED = "failed"
"""Verdict of a diagnosis that ended in an error."""
CLEAR_GAIN = 200.0
"""nats that the true effect gains on data that were not used for its fit."""
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
    steps = [(f"one effect, {step}: top 1", _step(one, step)) for step in ("weak", "middle", "strong")]
    clean = [(f"one effect, {s}: exact, nothing extra", _step(one, s)) for s in ("middle", "strong")]
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


def _parameter_rows(records: Iterable[Record]) -> list[Row]:
    found = [p for r in records if r["category"] in ("one", "two") for p in r["score"]["parameters"]]
    errors = [100.0 * p["relative_error"] for p in found if np.isfinite(p["relative_error"])]
    covered = [{"covered": p["covered"]} for p in found]
    return [
        _quantile("parameter error, median", errors, 0.5, "%"),
        _quantile("parameter error, 90 % quantile", errors, 0.9, "%"),
        _share("parameter inside its 95 % interval", covered, lambda p: p["covered"]),
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


# ---- The question: columns and data-sheet values in, the JSON form of one joint out ----------------


COLUMNS = (
    "motor_shaft_position",
    "joint_position",
    "gauge_torque",
    "motor_torque",
    "temperature",
    "reference_position",
)


def joint_model(model: Mapping[str, Any]) -> JointModel:
    """The nominal joint of a pair as the drive model's own type; every value says that it is of the data sheet."""
    from hd_control.drive.model import JointModel, ModelValue

    effects = {
        effect: {name: ModelValue(value=value, source="datasheet") for name, value in values.items()}
        for effect, values in model["effects"].items()
    }
    return JointModel(gear_ratio=model["gear_ratio"], rated_torque=model["rated_torque"], effects=effects)


def nominal_model(model: Mapping[str, Any]) -> Model:
    """The nominal model of a pair: its robot and its joint."""
    from hd_control.drive.model import Model

    return Model(model["robot"], {model["joint"]: joint_model(model)})


def recording(columns: Mapping[str, FloatArray], joint: str, period: float) -> Recording:
    """The columns of a recording as the analysis reads them from a bag."""
    from hd_control.lab.signals.joint_signals import JointSignals, Recording

    signals = JointSignals(
        joint=joint,
        time=columns["time"],
        period=period,
        valid=np.ones(columns["time"].size, dtype=bool),
        sources={name: name for name in COLUMNS},
        motor_shaft_position=columns["motor_shaft_position"],
        joint_position=columns["joint_position"],
        gauge_torque=columns["gauge_torque"],
        motor_torque=columns["motor_torque"],
        temperature=columns["temperature"],
        reference_position=columns["reference_position"],
    )
    return Recording("", "", {joint: signals})


def ask(question: Question) -> Mapping[str, Any]:
    """The diagnosis of the first recording."""
    from hd_control.lab.models.answers import diagnose_joint

    joint = str(question.model["joint"])
    answer = diagnose_joint(recording(question.fit, joint, question.period), nominal_model(question.model), joint)
    return answer.json()


HELD_OUT_EVERY = 4
"""Of how many joints the held-out reduction is measured once; it costs more than the diagnosis."""


def oracle(question: Question, answer: Mapping[str, Any], names: Sequence[str], seed: int) -> dict[str, float | None]:
    """What the true structure gains on the fitted recording, and what the answer reaches of it on the other one."""
    gains = {e["name"]: float(e.get("gain_nats") or 0.0) for e in answer.get("effects") or []}
    named = list(gains)
    true_gains = [gains[n] if n in gains else _gain_of(question, n, [m for m in names if m != n]) for n in names]
    share = None
    if seed % HELD_OUT_EVERY == 0 and named:
        base, answered, true = (_held_out(question, effects) for effects in ([], named, list(names)))
        share = (base - answered) / (base - true) if base > true else None
    return {"gain": min(true_gains, default=0.0), "held_out_share": share}


def _fitted(question: Question, effects: Sequence[str]) -> tuple[Model, float]:
    """The model with these effects, fitted one after the other, and what the last one gained, nats."""
    from dataclasses import replace

    from hd_control.core.errors import HdError
    from hd_control.lab.models.answers import joint_task
    from hd_control.lab.models.fit_model import fit_joint

    joint = str(question.model["joint"])
    model, gain = nominal_model(question.model), 0.0
    columns = recording(question.fit, joint, question.period)
    for effect in [None, *effects]:
        try:
            found = fit_joint(joint_task(columns, model, joint), model.joint(joint), effect)
        except HdError:  # what the recording does not show is not added
            gain = 0.0
            continue
        model, gain = replace(model, joints={joint: found.model}), found.gain
    return model, gain


def _gain_of(question: Question, effect: str, others: Sequence[str]) -> float:
    return _fitted(question, [*others, effect])[1]


def _held_out(question: Question, effects: Sequence[str]) -> float:
    """Squared held-out errors over the noise floor, channels added, of a fit with these effects."""
    from hd_control.lab.models.answers import compare_task, joint_task

    joint = str(question.model["joint"])
    model, _ = _fitted(question, effects)
    task = joint_task(recording(question.held_out, joint, question.period), model, joint)
    channels = compare_task(task, model, joint).channels.values()
    return sum((channel.rms_error / channel.noise_floor) ** 2 for channel in channels)


# ---- The campaign ----------------------------------------------------------------------------------


SCHEMA = "hd.campaign/1"


@dataclass(frozen=True)
class Question:
    """What the diagnosis may know: two recordings and the nominal model of one joint, as in `recordings.Pair`."""

    period: float
    fit: Mapping[str, FloatArray]
    held_out: Mapping[str, FloatArray]
    model: Mapping[str, Any]


Ask = Callable[[Question], Mapping[str, Any]]
"""A diagnosis: the JSON form of one joint, schema hd.diagnosis/1."""
Oracle = Callable[[Question, Mapping[str, Any], Sequence[str], int], Mapping[str, float | None]]
"""After the answer, with the true names and the seed: `gain`, nats that the weakest of the true effects gains beside
the others, and `held_out_share`, held-out reduction of the answer over that of the true structure; None: not measured.
"""


@dataclass(frozen=True)
class Campaign:
    """Seeds `seed` to `seed + count - 1` of one kind (mix or a category); `judge` as in `draw.draw_case`."""

    count: int
    seed: int
    kind: str = "mix"
    judge: bool | None = None

    def seeds(self) -> range:
        """The seeds in their order."""
        return range(self.seed, self.seed + self.count)

    def header(self) -> dict[str, Any]:
        """First line of a record file."""
        return {"schema": SCHEMA, "seed": self.seed, "kind": self.kind, "judge": self.judge}


def run_one(campaign: Campaign, seed: int, ask: Ask, oracle: Oracle | None = None) -> dict[str, Any]:
    """One joint: recordings, blind answer, score. An error of the diagnosis is an answer too, the verdict `failed`."""
    pair = make_pair(seed, campaign.kind, campaign.judge)
    question = Question(pair.period, pair.fit, pair.held_out, pair.model)
    start = time.process_time()
    try:
        answer = dict(ask(question))
    except HdError as error:
        answer = {"verdict": FAILED, "effects": [], "unknown": None, "experiments": [], "error": str(error)}
    seconds = time.process_time() - start
    again = _after_experiment(pair, ask) if answer["verdict"] == REFUSED else None
    known: Mapping[str, float | None] = {}
    if oracle is not None and answer["verdict"] != FAILED and pair.case.names:
        known = oracle(question, answer, pair.case.names, seed)
    return _record(pair, answer, seconds, known, again)


def _after_experiment(pair: Pair, ask: Ask) -> dict[str, Any]:
    """What the diagnosis says once the judge has played the general recording on the same joint; scored."""
    bench = set_up(pair.case)
    fit, held_out = (bench.record("general", number, seconds) for number, seconds in ((2, FIT_S), (3, HELD_OUT_S)))
    try:
        answer = ask(Question(pair.period, fit, held_out, pair.model))
    except HdError as error:
        answer = {"verdict": FAILED, "error": str(error)}
    return score_joint(answer, _joint_truth(pair), pair.case.tolerated).to_dict()


def _joint_truth(pair: Pair) -> Mapping[str, Any]:
    truth: Mapping[str, Any] = pair.truth["joints"][pair.model["joint"]]
    return truth


def _record(
    pair: Pair, answer: dict[str, Any], seconds: float, known: Mapping[str, float | None], again: dict[str, Any] | None
) -> dict[str, Any]:
    case = pair.case
    record: dict[str, Any] = _plain(
        {
            "seed": case.seed,
            "category": case.category,
            "names": list(case.names),
            "unknown": list(case.unknown),
            "step": case.step,
            "strengths": [effect.strength for effect in case.effects],
            "motion": case.motion,
            "features": dict(case.features),
            "score": score_joint(answer, _joint_truth(pair), case.tolerated).to_dict(),
            "score_after_experiment": again,
            "answer": answer,
            "cpu_seconds": seconds,
            "held_out_share": known.get("held_out_share"),
            "oracle_gain": known.get("gain"),
        }
    )
    return record


def read_record(path: Path, campaign: Campaign) -> list[dict[str, Any]]:
    """Finished joints of a record file that belong to the campaign; a last line that was cut off is left out.

    Raises ConfigError if the file is no record, or of a campaign of another kind.
    """
    if not path.exists():
        return []
    found: list[dict[str, Any]] = []
    lines = path.read_text(encoding="utf-8").splitlines()
    for number, line in enumerate(lines, 1):
        try:
            entry = json.loads(line)
        except ValueError:
            if number == len(lines):
                break
            raise ConfigError(f"{path}: line {number}: not JSON; not a record of a campaign") from None
        if number == 1:
            _check_header(path, entry, campaign)
        elif entry["seed"] in campaign.seeds():
            found.append(entry)
    return found


def _check_header(path: Path, entry: Any, campaign: Campaign) -> None:
    if not isinstance(entry, dict) or entry.get("schema") != SCHEMA:
        raise ConfigError(f"{path}: not a record of a campaign (schema {SCHEMA})")
    same = {key: entry.get(key) for key in ("kind", "judge")}
    if same != {"kind": campaign.kind, "judge": campaign.judge}:
        raise ConfigError(f"{path}: a record of kind {same['kind']}, judge {same['judge']}; choose another file")


def run_campaign(
    campaign: Campaign, ask: Ask, jobs: int = 1, record: Path | None = None, oracle: Oracle | None = None
) -> Iterator[dict[str, Any]]:
    """Yields the records, first those that the record file holds already, then new ones as they are finished."""
    old = read_record(record, campaign) if record else []
    yield from old
    done = {entry["seed"] for entry in old}
    left = [seed for seed in campaign.seeds() if seed not in done]
    if not left:
        return
    stream = _open_record(record, campaign) if record else None
    try:
        for entry in _results(campaign, left, ask, jobs, oracle):
            if stream is not None:
                stream.write(json.dumps(entry) + "\n")
                stream.flush()
                os.fsync(stream.fileno())
            yield entry
    finally:
        if stream is not None:
            stream.close()


def _results(
    campaign: Campaign, seeds: Sequence[int], ask: Ask, jobs: int, oracle: Oracle | None
) -> Iterator[dict[str, Any]]:
    if jobs <= 1:
        for seed in seeds:
            yield run_one(campaign, seed, ask, oracle)
        return
    from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
    from multiprocessing import get_context

    waiting = list(reversed(seeds))
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=serve_only)
    try:
        running: set[Future[dict[str, Any]]] = set()
        while waiting or running:
            while waiting and len(running) < 2 * jobs:
                running.add(pool.submit(run_one, campaign, waiting.pop(), ask, oracle))
            finished, running = wait(running, return_when=FIRST_COMPLETED)
            for future in finished:
                yield future.result()
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _open_record(path: Path, campaign: Campaign) -> Any:
    """The record file, open at its end; a line that was cut off is removed."""
    if not path.exists():
        stream = path.open("x", encoding="utf-8")
        stream.write(json.dumps(campaign.header()) + "\n")
        return stream
    text = path.read_bytes()
    whole = text[: text.rfind(b"\n") + 1]
    if len(whole) != len(text):
        with path.open("r+b") as file:
            file.truncate(len(whole))
    return path.open("a", encoding="utf-8")


def _plain(value: Any) -> Any:
    """JSON's own types; NaN and infinities become null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    return None if isinstance(value, float) and not np.isfinite(value) else value
