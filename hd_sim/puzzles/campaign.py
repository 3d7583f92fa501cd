"""A blind campaign: many random joints, each diagnosed without its truth, each answer scored afterwards.

One line of JSON per joint goes to the record file as soon as it is known, so an interrupted campaign loses nothing and
goes on where it stopped. The diagnosis receives columns and nominal values, never the case.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hd_control.core.arrays import FloatArray
from hd_control.core.errors import ConfigError, HdError
from hd_control.core.workers import serve_only
from hd_sim.puzzles.puzzle import REFUSED, score_joint
from hd_sim.puzzles.real_like import REAL_LIKE, make_real_like_pair
from hd_sim.puzzles.recordings import FIT_S, HELD_OUT_S, Pair, make_pair, set_up
from hd_sim.puzzles.second import SECOND, make_second_pair, set_up_second
from hd_sim.puzzles.tables import FAILED

if TYPE_CHECKING:
    from hd_control.drive.model import JointModel, Model
    from hd_control.lab.signals.joint_signals import Recording


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
    """The columns of a recording, those that there are, as the analysis reads them from a bag."""
    from hd_control.lab.signals.joint_signals import JointSignals, Recording

    signals = JointSignals(
        joint=joint,
        time=columns["time"],
        period=period,
        valid=np.ones(columns["time"].size, dtype=bool),
        sources={name: name for name in COLUMNS if name in columns},
        motor_shaft_position=columns.get("motor_shaft_position"),
        joint_position=columns.get("joint_position"),
        gauge_torque=columns.get("gauge_torque"),
        motor_torque=columns.get("motor_torque"),
        temperature=columns.get("temperature"),
        reference_position=columns.get("reference_position"),
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
HOME, BOTH = "home", "both"
WORLDS = (HOME, SECOND, REAL_LIKE, BOTH)


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
    """Seeds `seed` to `seed + count - 1` of one kind (mix or a category), in one of `WORLDS`; of both worlds, even
    seeds are of the first. `judge`: as in `draw.draw_case`, for the first world."""

    count: int
    seed: int
    kind: str = "mix"
    judge: bool | None = None
    world: str = HOME

    def world_of(self, seed: int) -> str:
        """Which world makes the joint of a seed."""
        return (HOME, SECOND)[seed % 2] if self.world == BOTH else self.world

    def seeds(self) -> range:
        """The seeds in their order."""
        return range(self.seed, self.seed + self.count)

    def header(self) -> dict[str, Any]:
        """First line of a record file."""
        return {"schema": SCHEMA, "seed": self.seed, "kind": self.kind, "judge": self.judge, "world": self.world}


def run_one(campaign: Campaign, seed: int, ask: Ask, oracle: Oracle | None = None) -> dict[str, Any]:
    """One joint: recordings, blind answer, score. An error of the diagnosis is an answer too, the verdict `failed`."""
    pair = _pair(campaign, seed)
    question = Question(pair.period, pair.fit, pair.held_out, pair.model)
    start = time.process_time()
    try:
        answer = dict(ask(question))
    except HdError as error:
        answer = {"verdict": FAILED, "effects": [], "unknown": None, "experiments": [], "error": str(error)}
    seconds = time.process_time() - start
    asks_again = answer["verdict"] == REFUSED and pair.case.world != REAL_LIKE
    again = _after_experiment(pair, ask) if asks_again else None
    known: Mapping[str, float | None] = {}
    visible = _joint_truth(pair).get("visibility") or {}
    if visible and pair.case.effects:
        known = {"gain": min(visible[effect.name] for effect in pair.case.effects)}
    elif oracle is not None and pair.case.world == HOME and answer["verdict"] != FAILED and pair.case.names:
        known = oracle(question, answer, pair.case.names, seed)
    return _record(pair, answer, seconds, known, again)


def _pair(campaign: Campaign, seed: int) -> Pair:
    world = campaign.world_of(seed)
    if world != HOME:
        return (make_second_pair if world == SECOND else make_real_like_pair)(seed, campaign.kind)
    return make_pair(seed, campaign.kind, campaign.judge)


def _after_experiment(pair: Pair, ask: Ask) -> dict[str, Any]:
    """What the diagnosis says once the judge has played the general recording on the same joint; scored."""
    case = pair.case
    bench = set_up_second(case.seed, case.category) if case.world == SECOND else set_up(case)
    fit, held_out = (bench.record("general", number, seconds) for number, seconds in ((2, FIT_S), (3, HELD_OUT_S)))
    try:
        answer = ask(Question(pair.period, fit, held_out, pair.model))
    except HdError as error:
        answer = {"verdict": FAILED, "error": str(error)}
    return score_joint(answer, _joint_truth(pair), case.tolerated, case.neutral).to_dict()


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
            "world": case.world,
            "visibility": _joint_truth(pair).get("visibility"),
            "same_law": _joint_truth(pair).get("same_law", [] if case.features else list(case.names)),
            "score": score_joint(answer, _joint_truth(pair), case.tolerated, case.neutral).to_dict(),
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
    same = {"kind": entry.get("kind"), "judge": entry.get("judge"), "world": entry.get("world", HOME)}
    if same != {"kind": campaign.kind, "judge": campaign.judge, "world": campaign.world}:
        words = ", ".join(f"{key} {value}" for key, value in same.items())
        raise ConfigError(f"{path}: a record of {words}; choose another file")


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
