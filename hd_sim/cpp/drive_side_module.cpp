// Python face of the drive side: hd_sim._drive_side.
#include "capsules.hpp"
#include "drive_side.hpp"

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <memory>
#include <optional>
#include <stdexcept>
#include <vector>

#include "step.hpp"

namespace py = pybind11;
using Array = py::array_t<double, py::array::c_style>;
using hd_sim::DriveSide;

namespace {

template <class Number>
py::array seen(std::vector<Number>& memory, const py::object& owner) {
    return py::array_t<Number>({static_cast<py::ssize_t>(memory.size())}, {sizeof(Number)}, memory.data(), owner);
}

template <class Number>
auto block(std::vector<Number> DriveSide::* member) {
    return [member](const py::object& self) { return seen(self.cast<DriveSide&>().*member, self); };
}

std::unique_ptr<DriveSide> make_drive_side(const py::capsule& world, int n, std::size_t state_size, double period, const Array& gate_limits,
                                           const Array& guard_limits, const Array& bounds, const Array& gear_ratio,
                                           std::size_t position_at, std::size_t velocity_at, std::size_t before, std::size_t after) {
    if (gate_limits.size() != static_cast<py::ssize_t>(hd::GateLimits::size(n)) ||
        guard_limits.size() != static_cast<py::ssize_t>(hd::GuardLimits::size(n)) || bounds.size() != 3 * n ||
        gear_ratio.size() != n)
        throw std::invalid_argument("limits, bounds and gear ratios of all joints are needed");
    return std::make_unique<DriveSide>(*world.get_pointer<hd_sim::World>(), n, period, gate_limits.data(), guard_limits.data(),
                                       bounds.data(), gear_ratio.data(), state_size, position_at, velocity_at, before, after);
}

// One of the side's acts for a loop.
template <class Act>
auto capsule(Act) {
    return [](const py::object& self) {
        const hd::Step step{&self.cast<DriveSide&>(),
                            [](void* side, std::int64_t tick) { Act{}(*static_cast<DriveSide*>(side), tick); }};
        return hd::owned_capsule(step, hd::kStepCapsule, self);
    };
}
struct Measure {
    void operator()(DriveSide& side, std::int64_t tick) const { side.measure(tick); }
};
struct Advance {
    void operator()(DriveSide& side, std::int64_t) const { side.advance(); }
};
struct AdvancePromptly {
    void operator()(DriveSide& side, std::int64_t) const { side.advance_promptly(); }
};
struct Look {
    void operator()(DriveSide& side, std::int64_t) const { side.look(); }
};
// The command of a run without topics: what the chain has allowed, taken at the end of each tick.
struct Take {
    void operator()(DriveSide& side, std::int64_t tick) const {
        side.offer(nullptr, side.n, side.incoming.data(), tick);
    }
};

// Where a loop leaves the commands that arrive.
py::capsule commands_capsule(const py::object& self) {
    const hd::Commands commands{
        &self.cast<DriveSide&>(),
        [](void* side, const int* joints, int count, const double* torque, std::int64_t tick) {
            return static_cast<DriveSide*>(side)->offer(joints, count, torque, tick);
        },
        [](void* side, int joint) {
            return static_cast<DriveSide*>(side)->command_tick[static_cast<std::size_t>(joint)];
        },
        [](void* side) { return static_cast<DriveSide*>(side)->stands(); },
        [](void* side) { static_cast<DriveSide*>(side)->stranger(); }};
    return hd::owned_capsule(commands, hd::kCommandsCapsule, self);
}

py::array rows_of(const double* rows, int count, int width) {
    py::array_t<double> found({static_cast<py::ssize_t>(count), static_cast<py::ssize_t>(width)});
    std::copy(rows, rows + count * width, found.mutable_data());
    return found;
}

}  // namespace

PYBIND11_MODULE(_drive_side, m) {
    m.doc() = "The simulated drives' electronics: command watchdog, guard, brake.";
    py::module_::import("hd_control._chain");  // knows guard, fault table and ring
    m.attr("ARMING_SAMPLES") = hd_sim::kArmingSamples;
    py::class_<DriveSide>(m, "DriveSide")
        .def(py::init(&make_drive_side), py::keep_alive<1, 2>())
        .def_property_readonly("guard", [](DriveSide& s) -> hd::Guard& { return s.guard; },
                               py::return_value_policy::reference_internal)
        .def_property_readonly("faults", [](DriveSide& s) -> hd::FaultTable& { return s.table; },
                               py::return_value_policy::reference_internal)
        .def_property_readonly("ring", [](DriveSide& s) -> hd::RowRing& { return s.ring; },
                               py::return_value_policy::reference_internal)
        .def_property_readonly("command", block(&DriveSide::command))
        .def_property_readonly("applied", block(&DriveSide::applied))
        .def_property_readonly("readings", block(&DriveSide::readings))
        .def_property_readonly("positions", block(&DriveSide::positions))
        .def_property_readonly("velocities", block(&DriveSide::velocities))
        .def_property_readonly("command_tick", block(&DriveSide::command_tick))
        .def_property_readonly("rows", [](const DriveSide& s) { return rows_of(s.rows.rows, s.rows.count, 5); })
        .def_property_readonly("refusals", [](const DriveSide& s) { return rows_of(s.refusals.data(), s.refused, 4); })
        .def_readonly("open", &DriveSide::open)
        .def_readonly("brake_closed", &DriveSide::brake_closed)
        .def_readonly("late", &DriveSide::late)
        .def_readonly("stale", &DriveSide::stale)
        .def_readonly("ahead", &DriveSide::ahead)
        .def_readonly("strangers", &DriveSide::strangers)
        .def_property_readonly("stands", &DriveSide::stands)
        .def("stranger", &DriveSide::stranger)
        .def_readwrite("healthy", &DriveSide::healthy)
        .def_property("reset_asked", [](const DriveSide& s) { return s.reset_asked.load(); },
                      [](DriveSide& s, bool asked) { s.reset_asked.store(asked); })
        .def_property_readonly("resets", [](const DriveSide& s) { return s.resets.load(); })
        .def("offer", [](DriveSide& s, const std::optional<std::vector<int>>& joints, const Array& torque,
                         std::int64_t tick) {
            const int count = joints ? static_cast<int>(joints->size()) : s.n;
            if (torque.size() != count) throw std::invalid_argument("torque: one number for each joint");
            for (int i = 0; joints && i < count; ++i)
                if ((*joints)[static_cast<std::size_t>(i)] < 0 || (*joints)[static_cast<std::size_t>(i)] >= s.n)
                    throw std::out_of_range("no such joint");
            return s.offer(joints ? joints->data() : nullptr, count, torque.data(), tick);
        })
        .def("complete", &DriveSide::complete)
        .def("latch", &DriveSide::latch)
        .def("sample", &DriveSide::sample)
        .def("measure", &DriveSide::measure)
        .def("advance", &DriveSide::advance)
        .def("reset", [](DriveSide& s, const Array& velocity) {
            if (velocity.size() != s.n) throw std::invalid_argument("velocity: one number for each joint");
            s.refused = s.reset(velocity.data(), s.refusals.data());
            return rows_of(s.refusals.data(), s.refused, 4);
        })
        .def("measure_capsule", capsule(Measure{}))
        .def("advance_capsule", capsule(Advance{}))
        .def("advance_promptly_capsule", capsule(AdvancePromptly{}))
        .def("look_capsule", capsule(Look{}))
        .def("take_capsule", capsule(Take{}))
        .def_property_readonly("true_position", block(&DriveSide::true_position))
        .def("commands_capsule", &commands_capsule)
        .def_property_readonly("state", &DriveSide::state)
        .def("state_capsule", [](const py::object& self) {
            const hd::Reading reading{&self.cast<DriveSide&>(), [](void* side) {
                return static_cast<std::int64_t>(static_cast<DriveSide*>(side)->state());
            }};
            return hd::owned_capsule(reading, hd::kReadingCapsule, self);
        })
        .def_property_readonly("incoming", block(&DriveSide::incoming));
}
