// Python module hd_control._motion: one sample of a motion law, rigid-body torque of a batch, splines.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include "motion_step.hpp"
#include "spline.hpp"

namespace py = pybind11;
using Array = py::array_t<double, py::array::c_style>;

namespace {

using namespace hd;

double* numbers(Array& array, std::size_t size, const char* name) {
    if (static_cast<std::size_t>(array.size()) != size) {
        throw std::invalid_argument(std::string(name) + ": wrong number of values");
    }
    return array.mutable_data();
}

const double* numbers(const Array& array, std::size_t size, const char* name) {
    if (static_cast<std::size_t>(array.size()) != size) {
        throw std::invalid_argument(std::string(name) + ": wrong number of values");
    }
    return array.data();
}

// A block that is only read; the struct of pointers is the same for reading and writing.
template <class Block>
Block reading(const Array& array, int joints, const char* name) {
    return Block(const_cast<double*>(numbers(array, Block::size(joints), name)), joints);
}

template <class Block>
Block writing(Array& array, int joints, const char* name) {
    return Block(numbers(array, Block::size(joints), name), joints);
}

void check_joints(int joints) {
    if (joints < 1 || joints > MAX_JOINTS) throw std::invalid_argument("joints: 1 to 32 are supported");
}

void step(const Array& params_, const Array& state_, const Array& sample_, const Array& reference_, Array output_,
          Array next_, int joints, double dt) {
    check_joints(joints);
    const auto params = reading<MotionParams>(params_, joints, "params");
    const auto sample = reading<MotionSample>(sample_, joints, "sample");
    const auto reference = reading<MotionReference>(reference_, joints, "reference");
    const double* state = numbers(state_, MotionState::size(joints), "state");
    double* output = numbers(output_, MotionOutput::size(joints), "output");
    motion_step(params, state, sample, reference, output, numbers(next_, MotionState::size(joints), "new state"),
                joints, dt);
}

// Joint torques of many states. rates and accelerations as in rigid_torque; all arrays (k, joints).
Array batch_torque(int joints, const Array& rotation, const Array& origin, double gravity, const Array& theta,
                   const Array& position, const Array& rate, const Array& required_rate, const Array& acceleration) {
    check_joints(joints);
    const std::size_t n = static_cast<std::size_t>(joints), size = static_cast<std::size_t>(position.size());
    if (size % n != 0) throw std::invalid_argument("position: wrong number of values");
    const Chain chain{joints, numbers(rotation, 9 * n, "rotation"), numbers(origin, 3 * n, "origin"), gravity};
    const double* parameters = numbers(theta, LINK_PARAMETERS * n, "link_parameters");
    const double *v = numbers(rate, size, "rate"), *v_r = numbers(required_rate, size, "required_rate");
    const double* a = numbers(acceleration, size, "acceleration");
    Array torque({static_cast<py::ssize_t>(size / n), static_cast<py::ssize_t>(n)});
    for (std::size_t i = 0; i < size; i += n) {
        rigid_torque(chain, parameters, position.data() + i, v + i, v_r + i, a + i, torque.mutable_data() + i, nullptr);
    }
    return torque;
}

// psi of every link, (joints, 13), for one state.
Array drive(int joints, const Array& params_, const Array& position, const Array& rate, const Array& required_rate,
            const Array& acceleration) {
    check_joints(joints);
    const std::size_t n = static_cast<std::size_t>(joints);
    const auto params = reading<MotionParams>(params_, joints, "params");
    Array psi({static_cast<py::ssize_t>(n), static_cast<py::ssize_t>(LINK_PARAMETERS)});
    double torque[MAX_JOINTS];
    rigid_torque(chain_of(params, joints), params.link_parameters, numbers(position, n, "position"),
                 numbers(rate, n, "rate"), numbers(required_rate, n, "required_rate"),
                 numbers(acceleration, n, "acceleration"), torque, psi.mutable_data());
    return psi;
}

template <class Block>
py::list field_list() {
    py::list list;
    for (const Field& field : Block::fields()) {
        list.append(py::make_tuple(field.name, field.per_joint, field.unit, field.meaning));
    }
    return list;
}

Spline spline_of(const Array& knots, const Array& coefficients, int joints) {
    check_joints(joints);
    if (knots.size() < 1) throw std::invalid_argument("knots: at least one");
    const std::size_t segments = static_cast<std::size_t>(knots.size()) - 1;
    const double* c = numbers(coefficients, 6 * segments * static_cast<std::size_t>(joints), "coefficients");
    return {joints, segments, knots.data(), c};
}

}  // namespace

PYBIND11_MODULE(_motion, module) {
    module.doc() = "Compiled motion laws, rigid-body torque and splines; see hd_control.laws.motion.";
    py::dict blocks;
    blocks["MotionParams"] = field_list<MotionParams>();
    blocks["MotionState"] = field_list<MotionState>();
    blocks["MotionSample"] = field_list<MotionSample>();
    blocks["MotionReference"] = field_list<MotionReference>();
    blocks["MotionOutput"] = field_list<MotionOutput>();
    module.attr("BLOCKS") = blocks;
    module.def("step", &step);
    module.def("batch_torque", &batch_torque);
    module.def("parameter_drive", &drive);
    module.def("spline_coefficients", [](int order, const Array& knots, double dt, const Array& q, const Array& v,
                                         const Array& a, int joints) {
        check_joints(joints);
        if (knots.size() < 1) throw std::invalid_argument("knots: at least one");
        const std::size_t points = static_cast<std::size_t>(knots.size()), size = points * joints;
        Array found({static_cast<py::ssize_t>(points) - 1, static_cast<py::ssize_t>(joints), py::ssize_t{6}});
        hermite(order, points, joints, knots.data(), dt, numbers(q, size, "positions"),
                order >= 3 ? numbers(v, size, "velocities") : nullptr,
                order >= 5 ? numbers(a, size, "accelerations") : nullptr, found.mutable_data());
        return found;
    });
    module.def("spline_evaluate", [](const Array& knots, const Array& coefficients, double tick, double dt,
                                     std::size_t cursor, Array out, int joints) {
        double* result = numbers(out, 3 * static_cast<std::size_t>(joints), "out");
        const Spline spline = spline_of(knots, coefficients, joints);
        if (spline.segments == 0) throw std::invalid_argument("knots: no segment to evaluate");
        return evaluate(spline, tick, dt, cursor, result);
    });
    module.def("spline_extrema", [](const Array& knots, const Array& coefficients, double dt, int joints) {
        const Spline spline = spline_of(knots, coefficients, joints);
        Array found({static_cast<py::ssize_t>(spline.segments), static_cast<py::ssize_t>(joints), py::ssize_t{6}});
        extrema(spline, dt, found.mutable_data());
        return found;
    });
}
