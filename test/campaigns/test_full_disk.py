"""Every kind of disk error at a random tick; torques stay bit for bit, the error is reported within a second.

The recorder's process ends with a code that is not 0: a real file-size limit is put on it while it records.
"""

from __future__ import annotations

import errno
import resource
import shutil

import numpy as np
from counts import SEED, count, enough
from node_runs import MortalSession, random_domain, run_with_goal
from results import write_result
from test_recording_failures import fail_once, torques

from hd_control.session.session import RunPlan

GOALS = ("G9",)

RUNS = 50
CODES = (errno.ENOSPC, errno.EIO, errno.EROFS, errno.EDQUOT, errno.EFBIG)


def test_g9_whatever_the_disk_does(tmp_path):
    runs, random, plain, wrong = count(RUNS), np.random.default_rng(SEED), torques(None)[0], []
    for number in range(runs):
        folder = tmp_path / str(number)
        code, tick = CODES[number % len(CODES)], int(random.integers(10, 1400))
        reported, problem = fail_once(folder, code, tick, plain)
        wrong += [f"{errno.errorcode[code]} at tick {tick}: {problem}"] if problem else []
        shutil.rmtree(folder)
    ended = exit_code_of_a_full_recorder(tmp_path)
    words = f"{len(wrong)} of {runs} runs{enough(runs, RUNS)} with a difference; a full recorder ends with code {ended}"
    write_result("G9", words, not wrong and ended == 1 and runs >= RUNS, runs=runs)
    assert not wrong, "\n".join(wrong[:5])
    assert ended == 1


def exit_code_of_a_full_recorder(folder):
    """Live nodes in lock-step; the recorder's files may not grow above 200 kB. The others go on to the end."""
    values = {"chain": {"pause_at_tick": 40}}
    plan = RunPlan(nodes=("chain",), lockstep=True, bag=folder / "bag", parameters=values)
    with MortalSession(plan, random_domain(), folder / "logs") as session:
        resource.prlimit(session.pid("recorder_node"), resource.RLIMIT_FSIZE, (200_000, 200_000))
        run_with_goal(session)
        assert session.diagnostics("chain")["gate_stopped"] == "False"
    assert session.exit_codes["chain"] == 0
    return session.exit_codes["recorder_node"]
