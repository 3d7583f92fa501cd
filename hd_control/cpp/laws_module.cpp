// Python face of the laws, the safety gate, the monitors' arithmetic and the splines: hd_control._laws.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cmath>
#include <cstring>
#include <stdexcept>
#include <string>
#include <vector>

#include "fusion.hpp"
#include "guard.hpp"
#include "integral_manifold.hpp"
#include "motion.hpp"
#include "safety.hpp"
#include "spline.hpp"
#include "torque_adaptive.hpp"
#include "torque_feedback.hpp"

namespace py = pybind11;
using Array = py::array_t<double, py::array::c_style>;

namespace {

using namespace hd;

// ------------------------------------------------------------------------------------------- arrays as blocks

void check_size(const Array& array, std::size_t size, const char* name) {
    if (static_cast<std::size_t>(array.size()) != size) {
        throw std::invalid_argument(std::string(name) + ": wrong number of values");
    }
}

const double* readable(const Array& array, std::size_t size, const char* name) {
    check_size(array, size, name);
    return array.data();
}

double* writable(Array& array, std::size_t size, const char* name) {
    check_size(array, size, name);
    return array.mutable_data();
}

// A block that is only read; the block type has one kind of pointer.
template <class Block>
Block reads(const Array& array, int joints, const char* name) {
    return Block(const_cast<double*>(readable(array, Block::size(joints), name)), joints);
}

template <class Block>
Block writes(Array& array, int joints, const char* name) {
    return Block(writable(array, Block::size(joints), name), joints);
}

// The next state starts as a copy of the present one; both may be the same array.
template <class Block>
Block continues(const Array& before, Array& after, int joints) {
    const double* from = readable(before, Block::size(joints), "state");
    double* to = writable(after, Block::size(joints), "new state");
    if (from != to) std::memcpy(to, from, Block::size(joints) * sizeof(double));
    return Block(to, joints);
}

template <class... Blocks>
py::dict field_lists() {
    py::dict lists;
    const auto add = [&lists](const char* name, const std::vector<Field>& fields) {
        py::list rows;
        for (const Field& field : fields)
            rows.append(py::make_tuple(field.name, field.per_joint, field.unit, field.meaning));
        lists[name] = rows;
    };
    (add(Blocks::block_name(), Blocks::fields()), ...);
    return lists;
}

// Block -> field -> kind, lowest, highest, lowest excluded, words; only fields that say what they may hold.
template <class... Blocks>
py::dict allowed_values() {
    py::dict blocks;
    const auto add = [&blocks](const char* name, const std::vector<Field>& fields) {
        py::dict found;
        for (const auto& [field, per_joint, unit, meaning, what] : fields) {
            if (std::string(what.kind) == "number" && std::isinf(what.low) && std::isinf(what.high)) continue;
            const py::object words = py::str(what.words).attr("split")();
            found[field] = py::make_tuple(what.kind, what.low, what.high, what.open_low, py::tuple(words));
        }
        blocks[name] = found;
    };
    (add(Blocks::block_name(), Blocks::fields()), ...);
    return blocks;
}

// Block -> field -> live factor, live share; only fields that may go somewhere while the law runs.
template <class... Blocks>
py::dict live_reach() {
    py::dict blocks;
    const auto add = [&blocks](const char* name, const std::vector<Field>& fields) {
        py::dict found;
        for (const Field& field : fields) {
            const Allowed& what = field.allowed;
            if (what.live_factor != 1.0 || what.live_share != 0.0)
                found[field.name] = py::make_tuple(what.live_factor, what.live_share);
        }
        blocks[name] = found;
    };
    (add(Blocks::block_name(), Blocks::fields()), ...);
    return blocks;
}

// ---------------------------------------------------------------------------------- one sample of a law or the gate

void fusion_of_arrays(const Array& params, const Array& state, const Array& sample, Array output, Array new_state,
                      int joints, double dt) {
    const auto p = reads<FusionParams>(params, joints, "params");
    const auto in = reads<FusionSample>(sample, joints, "sample");
    auto out = writes<FusionOutput>(output, joints, "output");
    auto memory = continues<FusionState>(state, new_state, joints);
    fusion_step(p, memory, in, out, joints, dt);
}

// A torque law: all of them have the sample of the torque law.
template <class Params, class State, class Reference, class Output,
          void (*Law)(const Params&, State&, const TorqueSample&, const Reference&, Output&, int, double)>
void torque_law_of_arrays(const Array& params, const Array& state, const Array& sample, const Array& reference,
                          Array output, Array new_state, int joints, double dt) {
    const auto p = reads<Params>(params, joints, "params");
    const auto in = reads<TorqueSample>(sample, joints, "sample");
    const auto ref = reads<Reference>(reference, joints, "reference");
    auto out = writes<Output>(output, joints, "output");
    auto memory = continues<State>(state, new_state, joints);
    Law(p, memory, in, ref, out, joints, dt);
}

void check_joints(int joints) {
    if (joints < 1 || joints > MAX_JOINTS) throw std::invalid_argument("joints: 1 to 32 are supported");
}

void motion_of_arrays(const Array& params, const Array& state, const Array& sample, const Array& reference,
                      Array output, Array new_state, int joints, double dt) {
    check_joints(joints);
    const auto p = reads<MotionParams>(params, joints, "params");
    const auto in = reads<MotionSample>(sample, joints, "sample");
    const auto ref = reads<MotionReference>(reference, joints, "reference");
    const std::size_t size = MotionState::size(joints);
    motion_step(p, readable(state, size, "state"), in, ref, writable(output, MotionOutput::size(joints), "output"),
                writable(new_state, size, "new state"), joints, dt);
}

int gate_of_arrays(const Array& command, const Array& ages, const Array& ticks, const Array& limits, const Array& state,
                   Array output, Array new_state, Array fault_rows, int joints) {
    const auto bounds = reads<GateLimits>(limits, joints, "limits");
    auto memory = continues<GateState>(state, new_state, joints);
    const std::size_t n = static_cast<std::size_t>(joints);
    FaultRows faults{writable(fault_rows, n * kFaultsPerJoint * kFaultFields, "faults"), joints * kFaultsPerJoint};
    SafetyGate gate{bounds, memory, faults, joints};
    gate.run(readable(command, n, "command"), readable(ages, n, "ages"), readable(ticks, n, "ticks"),
             writable(output, n, "output"));
    return faults.count;
}

// ------------------------------------------------------------------------------------------- rigid arm and splines

// Joint torques of many states. rates and accelerations as in rigid_torque; all arrays (k, joints).
Array batch_torque(int joints, const Array& rotation, const Array& origin, double gravity, const Array& theta,
                   const Array& position, const Array& rate, const Array& required_rate, const Array& acceleration) {
    check_joints(joints);
    const std::size_t n = static_cast<std::size_t>(joints), size = static_cast<std::size_t>(position.size());
    if (size % n != 0) throw std::invalid_argument("position: wrong number of values");
    const Chain chain{joints, readable(rotation, 9 * n, "rotation"), readable(origin, 3 * n, "origin"), gravity};
    const double* parameters = readable(theta, LINK_PARAMETERS * n, "link_parameters");
    const double *v = readable(rate, size, "rate"), *v_r = readable(required_rate, size, "required_rate");
    const double* a = readable(acceleration, size, "acceleration");
    Array torque({static_cast<py::ssize_t>(size / n), static_cast<py::ssize_t>(n)});
    for (std::size_t i = 0; i < size; i += n) {
        rigid_torque(chain, parameters, position.data() + i, v + i, v_r + i, a + i, torque.mutable_data() + i, nullptr);
    }
    return torque;
}

// psi of every link, (joints, 13), for one state.
Array parameter_drive(int joints, const Array& params_, const Array& position, const Array& rate,
                      const Array& required_rate, const Array& acceleration) {
    check_joints(joints);
    const std::size_t n = static_cast<std::size_t>(joints);
    const auto params = reads<MotionParams>(params_, joints, "params");
    Array psi({static_cast<py::ssize_t>(n), static_cast<py::ssize_t>(LINK_PARAMETERS)});
    double torque[MAX_JOINTS];
    rigid_torque(chain_of(params, joints), params.link_parameters, readable(position, n, "position"),
                 readable(rate, n, "rate"), readable(required_rate, n, "required_rate"),
                 readable(acceleration, n, "acceleration"), torque, psi.mutable_data());
    return psi;
}

Array spline_coefficients(int order, const Array& knots, double dt, const Array& q, const Array& v, const Array& a,
                          int joints) {
    check_joints(joints);
    if (knots.size() < 1) throw std::invalid_argument("knots: at least one");
    const std::size_t points = static_cast<std::size_t>(knots.size()), size = points * joints;
    Array found({static_cast<py::ssize_t>(points) - 1, static_cast<py::ssize_t>(joints), py::ssize_t{6}});
    hermite(order, points, joints, knots.data(), dt, readable(q, size, "positions"),
            order >= 3 ? readable(v, size, "velocities") : nullptr,
            order >= 5 ? readable(a, size, "accelerations") : nullptr, found.mutable_data());
    return found;
}

Spline spline_of(const Array& knots, const Array& coefficients, int joints) {
    check_joints(joints);
    if (knots.size() < 1) throw std::invalid_argument("knots: at least one");
    const std::size_t segments = static_cast<std::size_t>(knots.size()) - 1;
    const double* c = readable(coefficients, 6 * segments * static_cast<std::size_t>(joints), "coefficients");
    return {joints, segments, knots.data(), c};
}

std::size_t spline_evaluate(const Array& knots, const Array& coefficients, double tick, double dt, std::size_t cursor,
                            Array out, int joints) {
    double* result = writable(out, 3 * static_cast<std::size_t>(joints), "out");
    const Spline spline = spline_of(knots, coefficients, joints);
    if (spline.segments == 0) throw std::invalid_argument("knots: no segment to evaluate");
    return evaluate(spline, tick, dt, cursor, result);
}

Array spline_extrema(const Array& knots, const Array& coefficients, double dt, int joints) {
    const Spline spline = spline_of(knots, coefficients, joints);
    Array found({static_cast<py::ssize_t>(spline.segments), static_cast<py::ssize_t>(joints), py::ssize_t{6}});
    extrema(spline, dt, found.mutable_data());
    return found;
}

// ------------------------------------------------------------------------------------------- names for Python

template <class Function>
void define_law(py::module_& module, const char* name, Function function, const char* text) {
    module.def(name, function, py::arg("params").noconvert(), py::arg("state").noconvert(),
               py::arg("sample").noconvert(), py::arg("reference").noconvert(), py::arg("output").noconvert(),
               py::arg("new_state").noconvert(), py::arg("joints"), py::arg("dt"), text);
}

void define_laws(py::module_& module) {
    module.def("fusion_step", &fusion_of_arrays, py::arg("params").noconvert(), py::arg("state").noconvert(),
               py::arg("sample").noconvert(), py::arg("output").noconvert(), py::arg("new_state").noconvert(),
               py::arg("joints"), py::arg("dt"), "One sample of the fusion law, all joints.");
    define_law(module, "motion_step", &motion_of_arrays, "One sample of a motion law, all joints.");
    define_law(module, "torque_step",
               &torque_law_of_arrays<TorqueParams, TorqueState, TorqueReference, TorqueOutput, torque_step>,
               "One sample of the torque law, all joints.");
    define_law(module, "manifold_step",
               &torque_law_of_arrays<ManifoldParams, ManifoldState, ManifoldReference, ManifoldOutput, manifold_step>,
               "One sample of the integral-manifold law with a reference and all its derivatives.");
    define_law(
        module, "manifold_chain_step",
        &torque_law_of_arrays<ManifoldParams, ManifoldState, TorqueReference, ManifoldOutput, manifold_chain_step>,
        "One sample of the integral-manifold law with the reference of the chain.");
    define_law(module, "feedback_step",
               &torque_law_of_arrays<FeedbackParams, FeedbackState, FeedbackReference, FeedbackOutput, feedback_step>,
               "One sample of the torque-feedback law with the rates of the required torque.");
    define_law(
        module, "feedback_chain_step",
        &torque_law_of_arrays<FeedbackParams, FeedbackState, TorqueReference, FeedbackOutput, feedback_chain_step>,
        "One sample of the torque-feedback law with the reference of the chain.");
    module.def("derivative_pole", &derivative_pole, py::arg("cutoff"), py::arg("dt"),
               "Pole of the derivative filter D for a cut-off in rad/s.");
    module.def("project", &project, py::arg("value"), py::arg("drive"), py::arg("gain"), py::arg("low"),
               py::arg("high"), py::arg("dt"), "One step of the projection function P.");
}

void define_arm(py::module_& module) {
    module.def("batch_torque", &batch_torque, "Joint torques of the rigid arm for many states.");
    module.def("parameter_drive", &parameter_drive, "What moves the adapted link parameters, for one state.");
    module.def("spline_coefficients", &spline_coefficients, "Coefficients of the spline through given points.");
    module.def("spline_evaluate", &spline_evaluate, "Position, velocity, acceleration at a tick; returns the segment.");
    module.def("spline_extrema", &spline_extrema, "Smallest and largest values of every segment.");
}

void define_safety(py::module_& module) {
    module.attr("FAULT_FIELDS") = kFaultFields;
    module.attr("FAULTS_PER_JOINT") = kFaultsPerJoint;
    module.def("gate_step", &gate_of_arrays, py::arg("command").noconvert(), py::arg("ages").noconvert(),
               py::arg("ticks").noconvert(), py::arg("limits").noconvert(), py::arg("state").noconvert(),
               py::arg("output").noconvert(), py::arg("new_state").noconvert(), py::arg("fault_rows").noconvert(),
               py::arg("joints"), "One sample of the safety gate. Returns the number of fault rows.");
}

}  // namespace

PYBIND11_MODULE(_laws, module) {
    module.doc() = "Compiled laws, safety gate, arithmetic of the monitors, splines.";
    module.attr("BLOCKS") =
        field_lists<FusionParams, FusionSample, FusionState, FusionOutput, MotionParams, MotionState, MotionSample,
                    MotionReference, MotionOutput, TorqueParams, TorqueSample, TorqueReference, TorqueState,
                    TorqueOutput, ManifoldParams, ManifoldReference, ManifoldState, ManifoldOutput, FeedbackParams,
                    FeedbackReference, FeedbackState, FeedbackOutput, GateLimits, GateState, GuardLimits>();
    module.attr("ALLOWED") = allowed_values<FusionParams, MotionParams, TorqueParams, ManifoldParams, FeedbackParams,
                                            GateLimits, GuardLimits>();
    module.attr("LIVE") = live_reach<FusionParams, MotionParams, TorqueParams, ManifoldParams, FeedbackParams>();
    define_laws(module);
    define_arm(module);
    define_safety(module);
}
