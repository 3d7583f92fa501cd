"""What compare, diagnose, add, ladder and report share: bag, models and joints from the command line; work by joint."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from hd_control.drive.model import Model
    from hd_control.lab.signals.joint_signals import Recording

Result = TypeVar("Result")
PARTLY_READ = 3
_JOB: Callable[[str], Any] | None = None


def add_bag_options(parser: argparse.ArgumentParser, bags: str = "one") -> None:
    """BAG, --model, --joint, --map, --start, --seconds."""
    if bags == "one":
        parser.add_argument("bag", metavar="BAG", help="bag folder, .mcap or .db3 file")
    parser.add_argument("--joint", metavar="NAME", action="append", help="only this joint; repeatable")
    parser.add_argument("--map", metavar="FILE", help="mapping of a foreign bag's topics, joints, signs and units")
    parser.add_argument("--start", metavar="S", type=float, default=0.0, help="leave out what is before, s [0]")
    parser.add_argument("--seconds", metavar="S", type=float, help="length to take, s [all]")


def one_thread() -> None:
    """Joints run side by side; linear algebra with threads of its own would only get in their way."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def open_bag(arguments: argparse.Namespace, bag: str) -> Recording:
    """The recording, all joints of it. Raises BagError or ConfigError."""
    from hd_control.lab.signals.recording import read_recording

    return read_recording(bag, arguments.map, None, arguments.start, arguments.seconds)


def open_model(path: str, recording: Recording) -> Model:
    """A model file; its robot is that of the recording if the file names none. Raises ConfigError."""
    from dataclasses import replace

    from hd_control.drive.model_file import load_model

    model = load_model(path)
    return replace(model, robot=recording.robot) if model.robot is None and recording.robot else model


def chosen_joints(arguments: argparse.Namespace, recording: Recording, model: Model) -> list[str]:
    """The joints asked for, or all that are recorded and modelled. Raises HdError if there is none."""
    from hd_control.core.errors import HdError

    both = [name for name in recording.joints if name in model.joints]
    for name in arguments.joint or ():
        if name not in both:
            where = "the bag" if name not in recording.joints else "the model"
            raise HdError(f"joint {name!r} is not in {where}; both have {', '.join(both) or 'no joint in common'}")
    if not both:
        there = f"{', '.join(recording.joints)} in the bag, {', '.join(model.joints)} in the model"
        raise HdError(f"{recording.path}: no recorded joint is in the model; there is {there}")
    return list(arguments.joint or both)


def by_joint(
    arguments: argparse.Namespace, joints: Sequence[str], work: Callable[[str], Result], what: str
) -> Iterator[tuple[str, Result]]:
    """(joint, work(joint)) in the order of the joints, on as many processes as there are cores."""
    from hd_control.cli.options import track

    workers = min(len(joints), os.cpu_count() or 1)
    results = ((name, work(name)) for name in joints) if workers < 2 else _side_by_side(joints, work, workers)
    yield from track(arguments, results, len(joints), what)


def _side_by_side(joints: Sequence[str], work: Callable[[str], Result], workers: int) -> Iterator[tuple[str, Result]]:
    """Forked workers share what is read already; they end with this process."""
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    from hd_control.core.workers import serve_only

    global _JOB
    _JOB = work
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("fork"), serve_only)
    try:
        futures = [(name, pool.submit(_call, name)) for name in joints]
        for name, future in futures:
            yield name, future.result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _call(joint: str) -> Any:
    assert _JOB is not None
    return _JOB(joint)


def report_recording(arguments: argparse.Namespace, recording: Recording) -> None:
    """Problems and notes of the recording, for people."""
    from hd_control.cli.options import say

    for text in (*recording.problems, *recording.notes):
        say(arguments, f"  ! {text}")


def bag_entry(recording: Recording) -> dict[str, str]:
    """`bag` of the JSON documents."""
    return {"path": recording.path, "sha256": recording.sha256}


def model_entry(path: str, model: Model) -> dict[str, str]:
    """`model` of the JSON documents."""
    from hd_control.drive.model_file import model_sha256

    return {"path": path, "sha256": model_sha256(model)}


def name_of(path: str) -> str:
    """The last part of a path: what a provenance may say of somebody's machine."""
    return os.path.basename(os.path.normpath(path))


def provenance(words: Sequence[str], recordings: Sequence[Recording]) -> dict[str, Any]:
    """The step of making that a model file carries: enough to make it again."""
    from hd_control import __version__

    return {
        "command": " ".join(["hd", *words]),
        "program": f"hd_control {__version__}",
        "bags": [{"path": name_of(r.path), "sha256": r.sha256} for r in recordings],
    }


def exit_code(recording: Recording) -> int:
    """3 if the recording could be read in part only."""
    return PARTLY_READ if recording.problems else 0


def quantity(value: float, unit: str) -> str:
    """A number with its unit, in thousandths or millionths where that reads better."""
    for factor, prefix in ((1.0, ""), (1e3, "m"), (1e6, "u")):
        if abs(value) * factor >= 0.1 or prefix == "u":
            return f"{value * factor:.3g} {prefix}{unit}"
    return f"{value:.3g} {unit}"
