"""A runner whose compiled stages are followed, tick by tick, by the plain ones of test/oracles/stages_law.py.

Each tick the oracle gets the blocks that the stage has read, acts, and everything that the stage says or remembers is
compared bit for bit. Before that a test may put odd numbers into what was read.
"""

from __future__ import annotations

import numpy as np
from bits import check, rows
from oracles import stages_law

from hd_control.core.faults import Action, Fault, FaultCode
from hd_sim.runner import Runner

LOOK_TICKS = 50
"""Texts are compared every so many ticks, and whenever something was found."""
UNKNOWN = Fault(FaultCode.STOP_LEFT, -1, float("nan"), float("nan"), Action.TORQUE_RAMP)
"""The cause of a stop whose fault nobody has kept."""


class Shadow:
    """The oracles of one runner's stages. `spoil(stage, tick)` may change a stage's sample and reference in place."""

    def __init__(self, runner: Runner, spoil=lambda stage, tick: None) -> None:
        self.spoil, self.names, self.ticks = spoil, runner.robot.joint_names, 0
        self.codes: set[FaultCode] = set()
        self.modes: set[str] = set()
        self.stages = {stage.wiring.name: stage for _, stage in runner.stages}
        self.oracles = self._made(runner)
        self.resets = {"motion": 0, "torque": 0}
        self.stops = 0
        for name, stage in self.stages.items():
            self._follow(name, stage)

    def _made(self, runner):
        robot, dt, joints = runner.robot, runner.period, runner.torque.joint_names
        picked = robot.indices(joints)
        bounds = robot.position_low[picked], robot.position_high[picked], robot.velocity_limit[picked]
        limits, blend = runner.torque.limits, runner.motion.blend_time
        params = {name: stage.params.copy() for name, stage in self.stages.items()}
        return {
            "fusion": stages_law.FusionStage(params["fusion"], dt, limits),
            "motion": stages_law.MotionStage(params["motion"], dt, robot.joint_names, blend),
            "torque": stages_law.TorqueStage(params["torque"], dt, joints, limits, *bounds),
        }

    def _follow(self, name, stage):
        act, hand_over = stage.act, getattr(stage, "hand_over", None)

        def both(tick):
            self.spoil(stage, tick)
            self._give(name)
            act(tick)
            with np.errstate(all="ignore"):
                self.oracles[name].act(tick)
            self._compare(name, tick)

        def handed(path):
            self.oracles["motion"].path = path
            hand_over(path)

        stage.act = both
        if hand_over is not None:
            stage.hand_over = handed

    def _give(self, name):
        stage, oracle = self.stages[name], self.oracles[name]
        oracle.sample.array[:] = stage.sample.array
        if oracle.reference is not None and name == "torque":
            oracle.reference.array[:] = stage.reference.array
            oracle.input_ticks[:] = stage.input_ticks
        if name == "motion":
            oracle.controller_mode = stage.controller_mode

    # ---- what a test does to both ----------------------------------------------------------------------------

    def adopt(self, name, params):
        """New parameters."""
        self.stages[name].adopt(params)
        self.oracles[name].adopt(params.copy())

    def restart(self):
        """A new activation of every stage."""
        for name, stage in self.stages.items():
            stage.start()
            self.oracles[name].start()

    def ask_reset(self, name):
        """The reset service of one stage."""
        self.stages[name].reset_asked = self.oracles[name].reset_asked = True

    def throw(self):
        """An exception somewhere in the process of the torque law."""
        self.stages["torque"].emergency()
        self.oracles["torque"].failed = True

    # ---- the comparison --------------------------------------------------------------------------------------

    def _compare(self, name, tick):
        stage, oracle, where = self.stages[name], self.oracles[name], f"{name} in tick {tick}"
        state = oracle.state
        check(where, sample=(stage.sample.array, oracle.sample.array), output=(stage.output.array, oracle.output.array),
              params=(stage.params.array, oracle.params.array), state=(stage.state.array, state.array),
              tick=(stage.tick, oracle.tick))  # fmt: skip
        getattr(self, f"_compare_{name}")(stage, oracle, where)
        if name != "motion":
            check(where, faults=(stage.native.rows, rows(oracle.found)))
            self.codes |= {fault.code for fault in oracle.found}
            if oracle.found or tick % LOOK_TICKS == 0:
                book, log = stage.faults, oracle.faults
                check(where, book=(str(book.values(self.names)), str(log.values(self.names))),
                      first_stop=(str(book.first_stop), str(log.first_stop)),
                      first_stop_tick=(book.first_stop_tick, log.first_stop_tick))  # fmt: skip
        self.ticks += 1

    def _compare_fusion(self, stage, oracle, where):
        nothing = np.full(len(self.names), np.nan)
        memory = oracle.redundancy
        mean, ripple = (nothing, nothing) if memory is None else (memory.mean, memory.ripple)
        check(where, raw=(stage.raw.array, oracle.raw.array), missed=(stage.missed_motion, oracle.missed_motion))
        check(where, mean=(stage.native.residual_mean, mean), ripple=(stage.native.residual_ripple, ripple),
              compared=(stage.native.compared, memory is not None))  # fmt: skip

    def _compare_motion(self, stage, oracle, where):
        native, wanted = stage.native, oracle.follower
        now = oracle.tick - oracle.slow.lag
        check(where, reference=(stage.reference.array, oracle.reference.array),
              goals=([stage.late_goals, stage.aborted_goals, stage.reset_asked, native.resets],
                     [oracle.late_goals, oracle.aborted_goals, oracle.reset_asked, oracle.resets]),
              slow=([native.rate, native.lag], [oracle.slow.rate, oracle.slow.lag]),
              moving=(native.moving(now), wanted.moving(now)),
              active=(_seen(native.active), _facts(wanted.active)),
              pending=(_seen(native.pending), _facts(wanted.pending)))  # fmt: skip
        self.resets["motion"] = oracle.resets

    def _compare_torque(self, stage, oracle, where):
        native, guard, wanted = stage.native, stage.guard, oracle.guard
        check(where, allowed=(stage.allowed, oracle.allowed), railed=(native.railed, oracle.railed),
              disobeyed=(native.disobeyed, oracle.disobeyed), idle=(native.idle, oracle.idle),
              adaptation=(native.adaptation, oracle.adaptation.array), gate=(guard.gate.array, wanted.gate.array),
              stop=(guard.stop.array, wanted.stop.array), measured=(guard.measured.array, wanted.measured.array),
              mean_torque=(guard.state.mean_torque, wanted.mean_torque), mode=(stage.mode, oracle.mode),
              last_tick=(guard.last_tick, wanted.last_tick), failed=(native.failed, oracle.failed),
              counts=([stage.degraded_samples, native.lost, native.warm, guard.healthy, native.resets],
                      [oracle.degraded_samples, oracle.lost, oracle.warm, wanted.healthy, oracle.resets]))  # fmt: skip
        self.modes.add(oracle.mode)
        if oracle.resets != self.resets["torque"]:
            check(where, answer=(stage.reset_answer, oracle.refused))
            stage.reset_answer, self.resets["torque"] = None, oracle.resets
        if wanted.stopped and native.ring.stops != self.stops:
            self.stops = native.ring.stops
            kept = native.ring.causes.reshape(-1, 5)[(self.stops - 1) % len(native.ring.stop_rows)]
            check(where, cause=(kept[None], rows([oracle.cause or UNKNOWN])))


def _facts(path):
    """What a path is: start, knots, end."""
    if path is None:
        return []
    end = path.end
    return [path.start_tick, path.knots.tolist(), [*end.position, *end.velocity, *end.acceleration]]


def _seen(path):
    """The same of a path as the compiled stage shows it."""
    return [] if path is None else [path[1], path[2].tolist(), path[3].tolist()]
