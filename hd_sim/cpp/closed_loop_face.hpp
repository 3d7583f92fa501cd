// Python face of the closed loop: arrays by name in, rows out.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <stdexcept>
#include <string>

#include "closed_loop.hpp"

namespace hd_sim {

namespace py = pybind11;
using LoopArray = py::array_t<double, py::array::c_style>;

// Arrays of a dict by name; sizes are checked, memory is shared. The dict keeps them alive.
class Named {
  public:
    explicit Named(const py::dict& given) : given_(given) {}

    double* array(const char* name, std::size_t size) const {
        auto found = py::cast<LoopArray>(given_[name]);
        if (static_cast<std::size_t>(found.size()) != size) {
            throw std::invalid_argument(std::string(name) + ": expected " + std::to_string(size) + " numbers, got " +
                                        std::to_string(found.size()));
        }
        return found.mutable_data();
    }

    template <class Number>
    Number number(const char* name) const {
        return py::cast<Number>(given_[name]);
    }

  private:
    const py::dict& given_;
};

// (ticks done, rows (ticks, 3 n) of true position, desired position, command, torque states (ticks, size)).
inline py::tuple run_closed_loop(World& world, std::size_t state_size, int joints, const py::dict& given, long first,
                                 std::size_t ticks) {
    const Named named(given);
    const std::size_t n = static_cast<std::size_t>(joints), segments = named.number<std::size_t>("segments");
    const LoopMemory memory{named.array("fusion_params", hd::FusionParams::size(joints)),
                            named.array("fusion_state", hd::FusionState::size(joints)),
                            named.array("motion_params", hd::MotionParams::size(joints)),
                            named.array("motion_state", hd::MotionState::size(joints)),
                            named.array("torque_params", hd::TorqueParams::size(joints)),
                            named.array("torque_state", hd::TorqueState::size(joints)),
                            named.array("command", n),
                            named.array("temperature", n),
                            named.number<double>("period"),
                            named.number<double>("lost_tolerance"),
                            named.number<double>("moving_speed"),
                            named.number<int>("temperature_ticks"),
                            named.number<int>("let_go_samples"),
                            named.number<bool>("prompt")};
    const auto side = [&](const std::string& name) {
        const auto part = [&](const char* what, std::size_t size) { return named.array((name + what).c_str(), size); };
        return GuardedSide(part("_limits", hd::GateLimits::size(joints)), part("_gate", hd::GateState::size(joints)),
                           part("_tick", n), part("_bounds", 4 * n), named.number<double>("age_limit"), joints);
    };
    GuardedSide control = side("control"), drive = side("drive");
    DriveSense sense{named.array("drive_positions", 2 * n), named.array("drive_velocities", 2 * n),
                     named.array("gear_ratio", n), named.number<double>("velocity_rate"),
                     named.number<double>("velocity_weight")};
    Reference reference{
        {joints, segments, named.array("knots", segments + 1), named.array("coefficients", segments * n * 6)},
        named.number<double>("start_tick"),
        named.array("rest", n),
        named.array("end", 3 * n)};
    LoopArray rows({py::ssize_t{3}, static_cast<py::ssize_t>(ticks), static_cast<py::ssize_t>(n)});
    LoopArray states({static_cast<py::ssize_t>(ticks), static_cast<py::ssize_t>(hd::TorqueState::size(joints))});
    double* to = rows.mutable_data();
    const LoopRows out{to, to + ticks * n, to + 2 * ticks * n, states.mutable_data()};
    ClosedLoop loop(world, memory, control, drive, sense, reference, state_size,
                    named.number<std::size_t>("position_at"), joints);
    std::size_t done = 0;
    {
        py::gil_scoped_release released;
        done = loop.run(first, ticks, out);
    }
    return py::make_tuple(done, rows, states);
}

}  // namespace hd_sim
