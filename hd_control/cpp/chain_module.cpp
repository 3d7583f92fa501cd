// Python face of the tick: hd_control._chain. Blocks are views of the memory that the tick works on.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "capsules.hpp"
#include "chain.hpp"
#include "sequence.hpp"

namespace py = pybind11;
using namespace hd;
using Array = py::array_t<double, py::array::c_style>;

namespace {

const double* numbers(const Array& array, std::size_t size, const char* name) {
    if (static_cast<std::size_t>(array.size()) != size)
        throw std::invalid_argument(std::string(name) + ": wrong number of values");
    return array.data();
}

void check_joints(int joints) {
    if (joints < 1 || joints > MAX_JOINTS) throw std::invalid_argument("joints: 1 to 32 are supported");
}

// A view that keeps its owner alive and may be written to.
py::array view(std::vector<double>& memory, const py::object& owner) {
    return py::array_t<double>({static_cast<py::ssize_t>(memory.size())}, {sizeof(double)}, memory.data(), owner);
}

template <class Owner>
auto block(std::vector<double> Owner::* member) {
    return [member](const py::object& self) { return view(self.cast<Owner&>().*member, self); };
}

py::array rows_of(const FaultRows& rows) {
    py::array_t<double> found({static_cast<py::ssize_t>(rows.count), static_cast<py::ssize_t>(kFaultFields)});
    std::copy(rows.rows, rows.rows + kFaultFields * rows.count, found.mutable_data());
    return found;
}

RampPlan plan_of(const std::vector<int>& kinds, const std::vector<std::pair<int, int>>& starts) {
    RampPlan plan;
    plan.kind.assign(kinds.begin(), kinds.end());
    plan.starts = starts;
    return plan;
}

template <class Block>
py::list field_list() {
    py::list list;
    for (const Field& field : Block::fields())
        list.append(py::make_tuple(field.name, field.per_joint, field.unit, field.meaning));
    return list;
}

template <class Tick>
py::capsule step_capsule(const py::object& self) {
    const Step step{&self.cast<Tick&>(), [](void* tick, std::int64_t now) { static_cast<Tick*>(tick)->act(now); }};
    return owned_capsule(step, kStepCapsule, self);
}

// ------------------------------------------------------------------------------------------------ guard

std::unique_ptr<Guard> make_guard(const Array& gate_limits, const Array& guard_limits, const Array& bounds, int joints,
                                  double dt, double hold_samples) {
    check_joints(joints);
    return std::make_unique<Guard>(numbers(gate_limits, GateLimits::size(joints), "gate limits"),
                                   numbers(guard_limits, GuardLimits::size(joints), "guard limits"),
                                   numbers(bounds, static_cast<std::size_t>(3 * joints), "bounds"), joints, dt,
                                   hold_samples);
}

py::tuple guard_step(Guard& guard, const Array& command, const Array& ages, const Array& ticks,
                     const std::optional<Array>& demands) {
    const auto n = static_cast<std::size_t>(guard.n);
    OwnRows rows(Guard::kGuardRows(guard.n));
    if (demands) {
        if (demands->size() % kFaultFields != 0) throw std::invalid_argument("demands: five numbers each");
        const int count = static_cast<int>(demands->size()) / kFaultFields;
        const FaultRows given{const_cast<double*>(demands->data()), count, count};
        for (int i = 0; i < count; ++i) rows.copy(given, i);
    }
    const int asked = rows.count;
    Array out(static_cast<py::ssize_t>(n));
    if (asked > 0) {  // the monitors' rows are judged with those of this sample
        OwnRows all(Guard::kGuardRows(guard.n));
        for (int i = 0; i < asked; ++i) all.copy(rows, i);
        guard.step(numbers(command, n, "command"), numbers(ages, n, "ages"), numbers(ticks, n, "ticks"),
                   out.mutable_data(), all);
        return py::make_tuple(out, rows_of(all));
    }
    guard.step(numbers(command, n, "command"), numbers(ages, n, "ages"), numbers(ticks, n, "ticks"),
               out.mutable_data(), rows);
    return py::make_tuple(out, rows_of(rows));
}

py::array guard_reset(Guard& guard, bool others) {
    std::vector<double> rows(static_cast<std::size_t>(4 * (2 * guard.n + 1)));
    const int count = guard.reset(rows.data(), others);
    py::array_t<double> found({static_cast<py::ssize_t>(count), py::ssize_t{4}});
    std::copy(rows.begin(), rows.begin() + 4 * count, found.mutable_data());
    return found;
}

void bind_guard(py::module_& m) {
    py::class_<Guard>(m, "Guard")
        .def(py::init(&make_guard), py::arg("gate_limits"), py::arg("guard_limits"), py::arg("bounds"),
             py::arg("joints"), py::arg("dt"), py::arg("hold_samples"))
        .def_property_readonly("gate", block(&Guard::gate_state))
        .def_property_readonly("state", block(&Guard::guard_state))
        .def_property_readonly("stop", block(&Guard::stop_state))
        .def_property_readonly("measured", block(&Guard::measured))
        .def_property_readonly("mode", &Guard::mode)
        .def_property_readonly("stopped", &Guard::stopped)
        .def("activate", [](Guard& g, const Array& applied) {
            g.activate(numbers(applied, static_cast<std::size_t>(g.n), "applied"));
        })
        .def("deactivate", &Guard::deactivate)
        .def("look", &Guard::look)
        .def("step", &guard_step, py::arg("command"), py::arg("ages"), py::arg("ticks"), py::arg("demands") = py::none())
        .def("reset", &guard_reset, py::arg("others") = false);
}

// ------------------------------------------------------------------------------------------------ tables and rings

void bind_tables(py::module_& m) {
    py::class_<FaultTable>(m, "FaultTable")
        .def(py::init<int>())
        .def_readonly("joints", &FaultTable::joints)
        .def_readonly("stop_tick", &FaultTable::stop_tick)
        .def_property_readonly("entries", block(&FaultTable::entries))
        .def_property_readonly("stop", block(&FaultTable::stop))
        .def("clear", &FaultTable::clear)
        .def("take_over", [](FaultTable& table, const FaultTable& other) {
            if (table.joints != other.joints) throw std::invalid_argument("faults of other joints");
            table = other;
        })
        .def("note", [](FaultTable& table, const Array& rows, double tick) {
            const int count = static_cast<int>(rows.size()) / kFaultFields;
            table.note(FaultRows{const_cast<double*>(rows.data()), count, count}, tick);
        });
    py::class_<RowRing>(m, "RowRing")
        .def(py::init<std::size_t>())
        .def_readonly("rows", &RowRing::rows)
        .def_readonly("width", &RowRing::width)
        .def_property_readonly("written", [](const RowRing& r) { return r.written.load(); })
        .def_property_readonly("stops", [](const RowRing& r) { return r.stops.load(); })
        .def_property_readonly("stop_rows", block(&RowRing::stop_rows))
        .def_property_readonly("causes", block(&RowRing::causes))
        .def_property_readonly("data", block(&RowRing::data))
        .def("watch", [](RowRing& ring, Array array) {
            ring.watch(array.data(), static_cast<std::size_t>(array.size()));
        }, py::keep_alive<1, 2>())
        .def("note", [](RowRing& ring, double tick, const std::optional<Array>& cause) {
            ring.note(tick, cause ? numbers(*cause, kFaultFields, "cause") : nullptr);
        });
    m.attr("STOPS") = RowRing::kStops;
}

template <class Tick, class Class>
void bind_parameters(Class& c) {
    c.def("offer", [](Tick& t, const Array& b) { t.params.offer(numbers(b, t.params.now.size(), "parameters")); })
        .def("arrive", [](Tick& t) { t.params.arrive(); })
        .def_property_readonly("params", [](const py::object& self) {
            return view(self.cast<Tick&>().params.now, self);
        })
        .def_property_readonly("ramping", [](Tick& t) { return t.params.changes(); })
        .def_readwrite("tick", &Tick::tick)
        .def_readwrite("has_state", &Tick::has_state)
        .def("start", &Tick::start)
        .def("act", &Tick::act)
        .def("step_capsule", &step_capsule<Tick>);
}

// ------------------------------------------------------------------------------------------------ stages

void bind_fusion(py::module_& m) {
    py::class_<FusionTick> c(m, "FusionTick");
    c.def(py::init([](int joints, double dt, const Array& limits, const std::vector<int>& kinds) {
         check_joints(joints);
         return std::make_unique<FusionTick>(joints, dt, numbers(limits, GuardLimits::size(joints), "guard limits"),
                                             plan_of(kinds, {}));
     }))
        .def_property_readonly("sample", block(&FusionTick::sample))
        .def_property_readonly("raw", block(&FusionTick::raw))
        .def_property_readonly("output", block(&FusionTick::output))
        .def_property_readonly("state", block(&FusionTick::state))
        .def_property_readonly("residual_mean", [](const py::object& s) {
            return view(s.cast<FusionTick&>().watch.mean, s);
        })
        .def_property_readonly("residual_ripple", [](const py::object& s) {
            return view(s.cast<FusionTick&>().watch.ripple, s);
        })
        .def_property_readonly("missed_motion", [](const py::object& s) {
            return view(s.cast<FusionTick&>().watch.missed_motion, s);
        })
        .def_property_readonly("compared", [](const FusionTick& t) { return t.watch.compared(); })
        .def_property_readonly("rows", [](const FusionTick& t) { return rows_of(t.rows); })
        .def_property_readonly("faults", [](FusionTick& t) -> FaultTable& { return t.table; },
                               py::return_value_policy::reference_internal);
    bind_parameters<FusionTick>(c);
}

std::unique_ptr<MotionPath> make_path(std::int64_t id, std::int64_t start, double period, const Array& knots,
                                      const Array& coefficients, const Array& end) {
    if (end.size() % 3 != 0 || end.size() == 0) throw std::invalid_argument("end: position, velocity, acceleration");
    const int joints = static_cast<int>(end.size() / 3);
    check_joints(joints);
    auto path = Follower::path(joints, period);
    if (knots.size() < 1 || coefficients.size() != 6 * joints * (knots.size() - 1))
        throw std::invalid_argument("coefficients: wrong number of values");
    path->id = id;
    path->start[0] = path->start[1] = start;
    for (auto& half : path->knots) half.assign(knots.data(), knots.data() + knots.size());
    path->coefficients.assign(coefficients.data(), coefficients.data() + coefficients.size());
    path->end.assign(end.data(), end.data() + end.size());
    return path;
}

// What a path is now, for threads beside the loop: id, start tick, knots, end; none for a null pointer.
py::object seen(const MotionPath* path) {
    if (path == nullptr) return py::none();
    const int half = path->half.load(std::memory_order_acquire);
    const auto& knots = path->knots[half];
    return py::make_tuple(path->id, path->start[half],
                          Array(static_cast<py::ssize_t>(knots.size()), knots.data()),
                          Array(static_cast<py::ssize_t>(path->end.size()), path->end.data()));
}

void bind_motion(py::module_& m) {
    py::class_<MotionPath>(m, "MotionPath")
        .def(py::init(&make_path), py::arg("id"), py::arg("start"), py::arg("period"), py::arg("knots"),
             py::arg("coefficients"), py::arg("end"))
        .def_readonly("id", &MotionPath::id);
    py::class_<MotionTick> c(m, "MotionTick");
    c.def(py::init([](int joints, double dt, const std::vector<int>& kinds) {
         check_joints(joints);
         return std::make_unique<MotionTick>(joints, dt, plan_of(kinds, {}));
     }))
        .def_property_readonly("sample", block(&MotionTick::sample))
        .def_property_readonly("reference", block(&MotionTick::reference))
        .def_property_readonly("output", block(&MotionTick::output))
        .def_property_readonly("state", block(&MotionTick::state))
        .def_property("mode", [](const MotionTick& t) { return t.mode.load(); },
                      [](MotionTick& t, int mode) { t.mode.store(mode); })
        .def_property("reset_asked", [](const MotionTick& t) { return t.reset_asked.load(); },
                      [](MotionTick& t, bool asked) { t.reset_asked.store(asked); })
        .def_property_readonly("resets", [](const MotionTick& t) { return t.resets.load(); })
        .def_readonly("late_goals", &MotionTick::late_goals)
        .def_readonly("aborted_goals", &MotionTick::aborted_goals)
        .def_property_readonly("rate", [](const MotionTick& t) { return t.slow.rate; })
        .def_property_readonly("lag", [](const MotionTick& t) { return t.slow.lag; })
        // The caller keeps a path alive while the loop may follow it.
        .def("hand_over", [](MotionTick& t, MotionPath& path) {
            if (path.joints != t.n) throw std::invalid_argument("path: wrong number of joints");
            t.handover.store(&path, std::memory_order_release);
        })
        .def_property_readonly("handed_over", [](const MotionTick& t) {
            const MotionPath* path = t.handover.load();
            return path == nullptr ? py::object(py::none()) : py::object(py::int_(path->id));
        })
        .def_property_readonly("active", [](const MotionTick& t) { return seen(t.follower.active.load()); })
        .def_property_readonly("pending", [](const MotionTick& t) { return seen(t.follower.pending.load()); })
        .def("moving", [](const MotionTick& t, double tick) { return t.follower.set() && t.follower.moving(tick); });
    bind_parameters<MotionTick>(c);
}

void bind_torque(py::module_& m) {
    py::class_<TorqueTick> c(m, "TorqueTick");
    c.def(py::init([](int joints, double dt, int law, const Array& gate_limits, const Array& guard_limits,
                      const Array& bounds, std::size_t before, std::size_t after, const std::vector<int>& kinds,
                      const std::vector<std::pair<int, int>>& starts, const std::vector<double>& unseen_inputs) {
         check_joints(joints);
         return std::make_unique<TorqueTick>(
             joints, dt, static_cast<TorqueLaw>(law), numbers(gate_limits, GateLimits::size(joints), "gate limits"),
             numbers(guard_limits, GuardLimits::size(joints), "guard limits"),
             numbers(bounds, static_cast<std::size_t>(3 * joints), "bounds"), before, after, plan_of(kinds, starts),
             unseen_inputs);
     }))
        .def_property_readonly("sample", block(&TorqueTick::sample))
        .def_property_readonly("reference", block(&TorqueTick::reference))
        .def_property_readonly("output", block(&TorqueTick::output))
        .def_property_readonly("state", block(&TorqueTick::state))
        .def_property_readonly("adaptation", block(&TorqueTick::adaptation))
        .def_property_readonly("allowed", block(&TorqueTick::allowed))
        .def_property_readonly("input_ticks", block(&TorqueTick::input_ticks))
        .def_property_readonly("guard", [](TorqueTick& t) -> Guard& { return t.guard; },
                               py::return_value_policy::reference_internal)
        .def_property_readonly("faults", [](TorqueTick& t) -> FaultTable& { return t.table; },
                               py::return_value_policy::reference_internal)
        .def_property_readonly("ring", [](TorqueTick& t) -> RowRing& { return t.ring; },
                               py::return_value_policy::reference_internal)
        .def_property_readonly("rows", [](const TorqueTick& t) { return rows_of(t.rows); })
        .def_property_readonly("mode", &TorqueTick::mode)
        .def("mode_capsule", [](const py::object& self) {
            const Reading reading{&self.cast<TorqueTick&>(), [](void* tick) {
                return static_cast<std::int64_t>(static_cast<TorqueTick*>(tick)->mode());
            }};
            return owned_capsule(reading, kReadingCapsule, self);
        })
        .def_readwrite("gate_open", &TorqueTick::gate_open)
        .def_readwrite("degraded_samples", &TorqueTick::degraded_samples)
        .def_readwrite("lost", &TorqueTick::lost)
        .def_readwrite("warm", &TorqueTick::warm)
        .def_readonly("idle", &TorqueTick::idle)
        .def_readwrite("compares_applied", &TorqueTick::compares_applied)
        .def_property_readonly("disobeyed", block(&TorqueTick::disobeyed))
        .def_property_readonly("railed", [](const py::object& s) { return view(s.cast<TorqueTick&>().railed, s); })
        .def_property("failed", [](const TorqueTick& t) { return t.failed.load(); },
                      [](TorqueTick& t, bool failed) { t.failed.store(failed); })
        .def_property("reset_asked", [](const TorqueTick& t) { return t.reset_asked.load(); },
                      [](TorqueTick& t, bool asked) { t.reset_asked.store(asked); })
        .def_property_readonly("resets", [](const TorqueTick& t) { return t.resets.load(); })
        .def_property_readonly("refusals", [](const TorqueTick& t) {
            py::array_t<double> found({static_cast<py::ssize_t>(t.refused), py::ssize_t{4}});
            std::copy(t.refusals.begin(), t.refusals.begin() + 4 * t.refused, found.mutable_data());
            return found;
        })
        .def("act_with", [](TorqueTick& t, std::int64_t now, const std::optional<Array>& given) {
            t.act_with(now, given ? numbers(*given, static_cast<std::size_t>(t.n), "command") : nullptr);
        });
    bind_parameters<TorqueTick>(c);
}

// ------------------------------------------------------------------------------------------------ sequence

Step step_of(const py::capsule& capsule) { return *capsule.get_pointer<Step>(); }

// 1 once one of some guards has stopped its robot: a run that nobody watches ends there.
struct StopFlag {
    std::vector<const Guard*> guards;
    std::vector<double> value = std::vector<double>(1, 0.0);

    static void look(void* self, std::int64_t) {
        auto* flag = static_cast<StopFlag*>(self);
        for (const Guard* guard : flag->guards) flag->value[0] = guard->stopped() ? 1.0 : flag->value[0];
    }
};

// The mode of the torque law for the motion law of the same process.
struct ModeLink {
    const TorqueTick* torque;
    MotionTick* motion;

    static void pass(void* self, std::int64_t) {
        auto* link = static_cast<ModeLink*>(self);
        link->motion->mode.store(link->torque->mode(), std::memory_order_relaxed);
    }
};

void bind_sequence(py::module_& m) {
    py::class_<StopFlag>(m, "StopFlag")
        .def(py::init([](const std::vector<Guard*>& guards) {
                 auto flag = std::make_unique<StopFlag>();
                 flag->guards.assign(guards.begin(), guards.end());
                 return flag;
             }),
             py::keep_alive<1, 2>())
        .def_property_readonly("value", block(&StopFlag::value))
        .def("step_capsule", [](const py::object& self) {
            return owned_capsule(Step{&self.cast<StopFlag&>(), &StopFlag::look}, kStepCapsule, self);
        });
    py::class_<ModeLink>(m, "ModeLink")
        .def(py::init([](TorqueTick& torque, MotionTick& motion) {
                 return std::make_unique<ModeLink>(ModeLink{&torque, &motion});
             }),
             py::keep_alive<1, 2>(), py::keep_alive<1, 3>())
        .def("step_capsule", [](const py::object& self) {
            return owned_capsule(Step{&self.cast<ModeLink&>(), &ModeLink::pass}, kStepCapsule, self);
        });
    py::class_<Sequence>(m, "Sequence")
        .def(py::init<>())
        .def("copy", [](Sequence& s, const Array& from, Array to) {
            if (from.size() != to.size()) throw std::invalid_argument("copy: different sizes");
            s.copy(from.data(), to.mutable_data(), static_cast<std::size_t>(from.size()));
        }, py::keep_alive<1, 2>(), py::keep_alive<1, 3>())
        .def("stamp", [](Sequence& s, Array ticks) {
            s.stamp(ticks.mutable_data(), static_cast<std::size_t>(ticks.size()));
        }, py::keep_alive<1, 2>())
        .def("call", [](Sequence& s, const py::capsule& step) { s.call(step_of(step)); }, py::keep_alive<1, 2>())
        .def("record", [](Sequence& s, const Array& from, Array table) {
            if (from.size() == 0 || table.size() % from.size() != 0) throw std::invalid_argument("record: rows differ");
            s.record(from.data(), table.mutable_data(), static_cast<std::size_t>(from.size()));
        }, py::keep_alive<1, 2>(), py::keep_alive<1, 3>())
        .def("every", &Sequence::every)
        .def("run", [](Sequence& s, std::int64_t first, std::size_t count, const std::optional<Array>& stop) {
            const double* flag = stop && stop->size() > 0 ? stop->data() : nullptr;
            py::gil_scoped_release released;
            return s.run(first, count, flag);
        }, py::arg("first"), py::arg("count"), py::arg("stop") = py::none())
        .def("step_capsule", [](const py::object& self) {
            return owned_capsule(Step{&self.cast<Sequence&>(), &Sequence::run_one}, kStepCapsule, self);
        });
}

}  // namespace

PYBIND11_MODULE(_chain, m) {
    m.doc() = "The compiled tick: stages with monitors, guard and gate; sequences of them.";
    py::dict blocks;
    blocks["GuardState"] = field_list<GuardState>();
    blocks["StopState"] = field_list<StopState>();
    blocks["GuardMeasured"] = field_list<GuardMeasured>();
    blocks["GuardLimits"] = field_list<GuardLimits>();
    blocks["AdaptationWatch"] = field_list<AdaptationWatch>();
    m.attr("BLOCKS") = blocks;
    m.attr("CODES") = kCodes;
    m.attr("WARM_TICKS") = kWarmTicks;
    bind_guard(m);
    bind_tables(m);
    bind_fusion(m);
    bind_motion(m);
    bind_torque(m);
    bind_sequence(m);
}
