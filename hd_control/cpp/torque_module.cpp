// Python face of the fusion law, the torque law and the safety gate: hd_control._torque.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <cstring>
#include <stdexcept>

#include "fusion.hpp"
#include "projection.hpp"
#include "safety_gate.hpp"
#include "torque_adaptive.hpp"

namespace py = pybind11;
using Array = py::array_t<double, py::array::c_style>;

namespace {

double* writable(Array& array, std::size_t size, const char* name) {
    if (static_cast<std::size_t>(array.size()) != size) {
        throw std::invalid_argument(std::string(name) + ": wrong number of values");
    }
    return array.mutable_data();
}

// The laws only read these; the block type has one kind of pointer.
double* readable(const Array& array, std::size_t size, const char* name) {
    if (static_cast<std::size_t>(array.size()) != size) {
        throw std::invalid_argument(std::string(name) + ": wrong number of values");
    }
    return const_cast<double*>(array.data());
}

template <class Block>
Block reads(const Array& array, int joints, const char* name) {
    return Block(readable(array, Block::size(joints), name), joints);
}

template <class Block>
Block writes(Array& array, int joints, const char* name) {
    return Block(writable(array, Block::size(joints), name), joints);
}

// The next state starts as a copy of the present one.
template <class Block>
Block continues(const Array& before, Array& after, int joints) {
    const double* from = readable(before, Block::size(joints), "state");
    double* to = writable(after, Block::size(joints), "new state");
    if (from != to) std::memcpy(to, from, Block::size(joints) * sizeof(double));
    return Block(to, joints);
}

void fusion_step(const Array& params, const Array& state, const Array& sample, Array output, Array new_state,
                 int joints, double dt) {
    auto p = reads<hd::FusionParams>(params, joints, "params");
    auto in = reads<hd::FusionSample>(sample, joints, "sample");
    auto out = writes<hd::FusionOutput>(output, joints, "output");
    auto memory = continues<hd::FusionState>(state, new_state, joints);
    hd::fusion_step(p, memory, in, out, joints, dt);
}

void torque_step(const Array& params, const Array& state, const Array& sample, const Array& reference, Array output,
                 Array new_state, int joints, double dt) {
    auto p = reads<hd::TorqueParams>(params, joints, "params");
    auto in = reads<hd::TorqueSample>(sample, joints, "sample");
    auto ref = reads<hd::TorqueReference>(reference, joints, "reference");
    auto out = writes<hd::TorqueOutput>(output, joints, "output");
    auto memory = continues<hd::TorqueState>(state, new_state, joints);
    hd::torque_step(p, memory, in, ref, out, joints, dt);
}

int gate_step(const Array& command, const Array& ages, const Array& ticks, const Array& limits, const Array& state,
              Array output, Array new_state, Array fault_rows, int joints) {
    auto bounds = reads<hd::GateLimits>(limits, joints, "limits");
    auto memory = continues<hd::GateState>(state, new_state, joints);
    const std::size_t n = static_cast<std::size_t>(joints);
    hd::GateFaults faults{writable(fault_rows, n * hd::kFaultsPerJoint * hd::kFaultFields, "faults")};
    hd::SafetyGate gate{bounds, memory, faults, joints};
    gate.run(readable(command, n, "command"), readable(ages, n, "ages"), readable(ticks, n, "ticks"),
             writable(output, n, "output"));
    return faults.count;
}

py::list listed(const std::vector<hd::Field>& fields) {
    py::list rows;
    for (const hd::Field& field : fields)
        rows.append(py::make_tuple(field.name, field.per_joint, field.unit, field.meaning));
    return rows;
}

}  // namespace

PYBIND11_MODULE(_torque, module) {
    module.doc() = "Compiled fusion law, adaptive torque law and safety gate.";
    py::dict blocks;
    blocks["FusionParams"] = listed(hd::FusionParams::fields());
    blocks["FusionSample"] = listed(hd::FusionSample::fields());
    blocks["FusionState"] = listed(hd::FusionState::fields());
    blocks["FusionOutput"] = listed(hd::FusionOutput::fields());
    blocks["TorqueParams"] = listed(hd::TorqueParams::fields());
    blocks["TorqueSample"] = listed(hd::TorqueSample::fields());
    blocks["TorqueReference"] = listed(hd::TorqueReference::fields());
    blocks["TorqueState"] = listed(hd::TorqueState::fields());
    blocks["TorqueOutput"] = listed(hd::TorqueOutput::fields());
    blocks["GateLimits"] = listed(hd::GateLimits::fields());
    blocks["GateState"] = listed(hd::GateState::fields());
    module.attr("BLOCKS") = blocks;
    module.attr("FAULT_FIELDS") = hd::kFaultFields;
    module.attr("FAULTS_PER_JOINT") = hd::kFaultsPerJoint;
    module.def("fusion_step", &fusion_step, py::arg("params").noconvert(), py::arg("state").noconvert(),
               py::arg("sample").noconvert(), py::arg("output").noconvert(), py::arg("new_state").noconvert(),
               py::arg("joints"), py::arg("dt"), "One sample of the fusion law, all joints.");
    module.def("torque_step", &torque_step, py::arg("params").noconvert(), py::arg("state").noconvert(),
               py::arg("sample").noconvert(), py::arg("reference").noconvert(), py::arg("output").noconvert(),
               py::arg("new_state").noconvert(), py::arg("joints"), py::arg("dt"),
               "One sample of the torque law, all joints.");
    module.def("gate_step", &gate_step, py::arg("command").noconvert(), py::arg("ages").noconvert(),
               py::arg("ticks").noconvert(), py::arg("limits").noconvert(), py::arg("state").noconvert(),
               py::arg("output").noconvert(), py::arg("new_state").noconvert(), py::arg("fault_rows").noconvert(),
               py::arg("joints"), "One sample of the safety gate. Returns the number of fault rows.");
    module.def("derivative_pole", &hd::derivative_pole, py::arg("cutoff"), py::arg("dt"),
               "Pole of the derivative filter D for a cut-off in rad/s.");
    module.def("project", &hd::project, py::arg("value"), py::arg("drive"), py::arg("gain"), py::arg("low"),
               py::arg("high"), py::arg("dt"), "One step of the projection function P.");
}
