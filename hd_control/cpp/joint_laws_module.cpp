// Python face of the laws for one joint: hd_control._joint_laws.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <cstring>
#include <stdexcept>
#include <string>

#include "integral_manifold_step.hpp"
#include "torque_feedback.hpp"

namespace py = pybind11;
using Array = py::array_t<double, py::array::c_style>;

namespace {

// The laws only read inputs; the block type has one kind of pointer.
template <class Block>
Block reads(const Array& array, int joints, const char* name) {
    if (static_cast<std::size_t>(array.size()) != Block::size(joints)) {
        throw std::invalid_argument(std::string(name) + ": wrong number of values");
    }
    return Block(const_cast<double*>(array.data()), joints);
}

template <class Block>
Block writes(Array& array, int joints, const char* name) {
    if (static_cast<std::size_t>(array.size()) != Block::size(joints)) {
        throw std::invalid_argument(std::string(name) + ": wrong number of values");
    }
    return Block(array.mutable_data(), joints);
}

// The next state starts as a copy of the present one; both may be the same array.
template <class Params, class State, class Reference, class Output,
          void (*Law)(const Params&, State&, const hd::TorqueSample&, const Reference&, Output&, int, double)>
void step(const Array& params, const Array& state, const Array& sample, const Array& reference, Array output,
          Array new_state, int joints, double dt) {
    auto before = reads<State>(state, joints, "state");
    auto after = writes<State>(new_state, joints, "new state");
    if (state.data() != new_state.data()) {
        std::memcpy(new_state.mutable_data(), state.data(), State::size(joints) * sizeof(double));
    }
    (void)before;
    auto p = reads<Params>(params, joints, "params");
    auto in = reads<hd::TorqueSample>(sample, joints, "sample");
    auto ref = reads<Reference>(reference, joints, "reference");
    auto out = writes<Output>(output, joints, "output");
    Law(p, after, in, ref, out, joints, dt);
}

py::list listed(const std::vector<hd::Field>& fields) {
    py::list rows;
    for (const hd::Field& field : fields)
        rows.append(py::make_tuple(field.name, field.per_joint, field.unit, field.meaning));
    return rows;
}

template <class Function>
void define(py::module_& module, const char* name, Function function, const char* text) {
    module.def(name, function, py::arg("params").noconvert(), py::arg("state").noconvert(),
               py::arg("sample").noconvert(), py::arg("reference").noconvert(), py::arg("output").noconvert(),
               py::arg("new_state").noconvert(), py::arg("joints"), py::arg("dt"), text);
}

}  // namespace

PYBIND11_MODULE(_joint_laws, module) {
    using namespace hd;
    module.doc() = "Compiled integral-manifold law and torque-feedback law.";
    py::dict blocks;
    blocks["ManifoldParams"] = listed(ManifoldParams::fields());
    blocks["ManifoldReference"] = listed(ManifoldReference::fields());
    blocks["ManifoldState"] = listed(ManifoldState::fields());
    blocks["ManifoldOutput"] = listed(ManifoldOutput::fields());
    blocks["FeedbackParams"] = listed(FeedbackParams::fields());
    blocks["FeedbackReference"] = listed(FeedbackReference::fields());
    blocks["FeedbackState"] = listed(FeedbackState::fields());
    blocks["FeedbackOutput"] = listed(FeedbackOutput::fields());
    module.attr("BLOCKS") = blocks;
    define(module, "manifold_step",
           &step<ManifoldParams, ManifoldState, ManifoldReference, ManifoldOutput, manifold_step>,
           "One sample of the integral-manifold law with a reference and all its derivatives.");
    define(module, "manifold_chain_step",
           &step<ManifoldParams, ManifoldState, TorqueReference, ManifoldOutput, manifold_chain_step>,
           "One sample of the integral-manifold law with the reference of the chain.");
    define(module, "feedback_step",
           &step<FeedbackParams, FeedbackState, FeedbackReference, FeedbackOutput, feedback_step>,
           "One sample of the torque-feedback law with the rates of the required torque.");
    define(module, "feedback_chain_step",
           &step<FeedbackParams, FeedbackState, TorqueReference, FeedbackOutput, feedback_chain_step>,
           "One sample of the torque-feedback law with the reference of the chain.");
}
