"""Nothing is imported inside the fast loop: one library that is loaded there costs hundreds of missed ticks."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from node_runs import random_domain

ROOT = Path(__file__).resolve().parents[2]
WATCHED = """
import os, signal, sys, threading

late, inside = [], []

class Watch:
    def find_spec(self, name, path=None, target=None):
        if inside and threading.current_thread() is threading.main_thread():
            late.append(name)
        return None

from hd_control.nodes import fast_loop
from hd_control.nodes.process import run_node
from hd_sim.nodes.chain import make_chain

run = fast_loop.FastLoop.run

def watched(loop):
    inside.append(True)
    threading.Timer(2.0, os.kill, (os.getpid(), signal.SIGINT)).start()
    try:
        run(loop)
    finally:
        inside.clear()
        turn = loop._turn
        print("ticks", turn.tick, "late imports", late, flush=True)

fast_loop.FastLoop.run = watched
sys.meta_path.insert(0, Watch())
run_node(make_chain)
"""


def test_a_chain_with_its_plant_imports_nothing_once_it_runs() -> None:
    options = ["autostart:=true", "with_plant:=true", "clock:=lockstep"]
    words = [word for option in options for word in ("-p", option)]
    done = subprocess.run(
        [sys.executable, "-c", WATCHED, "--ros-args", *words],
        cwd=ROOT, capture_output=True, text=True, timeout=60,
        env={**os.environ, "ROS_DOMAIN_ID": str(random_domain())},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    _, ticks, *_, found = done.stdout.split(maxsplit=4)
    assert int(ticks) > 100 and found == "[]\n", done.stdout
