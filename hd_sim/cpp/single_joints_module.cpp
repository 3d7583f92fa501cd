// Python face of the two single joints of the papers: hd_sim._single_joints.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>

#include "gear_joint.hpp"
#include "one_link_arm.hpp"

namespace py = pybind11;
using Array = py::array_t<double, py::array::c_style>;

namespace {

// Sample of the output side after each advance: joint position, velocity, torque, motor position, velocity, torque.
constexpr int kMeasured = 6;

Array zeros(int size) {
    Array array(size);
    std::fill(array.mutable_data(), array.mutable_data() + size, 0.0);
    return array;
}

struct GearJointFace {
    hd_sim::GearJoint joint;
    double ratio;
    Array measured = zeros(kMeasured);

    GearJointFace(const std::vector<double>& params, double gear_ratio) : joint(params), ratio(gear_ratio) {
        show(0.0);
    }

    void advance(double output_side_torque, double dt, int steps) {
        joint.advance(output_side_torque / ratio, dt, steps);
        show(output_side_torque);
    }

    void show(double torque) {
        const hd_sim::GearMotion& m = joint.motion();
        double* to = measured.mutable_data();
        to[0] = m.link, to[1] = m.link_rate, to[2] = -joint.spring_torque();
        to[3] = m.rotor / ratio, to[4] = m.rotor_rate / ratio, to[5] = torque;
    }
};

struct OneLinkFace {
    hd_sim::OneLinkArm arm;
    Array measured = zeros(kMeasured);

    explicit OneLinkFace(const std::vector<double>& params) : arm(params) {}

    void advance(double torque, double dt, int steps) {
        arm.advance(torque, dt, steps);
        double* to = measured.mutable_data();
        to[0] = arm.link, to[1] = arm.link_rate, to[2] = arm.joint_torque();
        to[3] = arm.rotor, to[4] = arm.rotor_rate, to[5] = torque;
    }
};

std::vector<double> checked(const std::vector<double>& params, std::size_t size) {
    if (params.size() != size) throw std::invalid_argument("params: wrong number of values");
    return params;
}

py::list listed(const std::vector<hd::Field>& fields) {
    py::list rows;
    for (const hd::Field& field : fields)
        rows.append(py::make_tuple(field.name, field.per_joint, field.unit, field.meaning));
    return rows;
}

}  // namespace

PYBIND11_MODULE(_single_joints, module) {
    module.doc() = "Single joints of Gandhi and Ghorbel (8)-(10) and Hashimoto (15)-(17), with exact hysteresis.";
    py::dict blocks;
    blocks["GearJointParams"] = listed(hd_sim::GearJointParams::fields());
    blocks["OneLinkParams"] = listed(hd_sim::OneLinkParams::fields());
    module.attr("BLOCKS") = blocks;
    py::class_<GearJointFace>(module, "GearJoint", "Joint with kinematic error and hysteresis; `measured` is a view.")
        .def(py::init([](const std::vector<double>& params, double ratio) {
                 return new GearJointFace(checked(params, hd_sim::GearJointParams::size(1)), ratio);
             }),
             py::arg("params"), py::arg("gear_ratio"))
        .def("advance", &GearJointFace::advance, py::arg("motor_torque"), py::arg("dt"), py::arg("steps"))
        .def_readonly("measured", &GearJointFace::measured)
        .def_property_readonly("wind_up", [](const GearJointFace& face) { return face.joint.wind_up(); });
    py::class_<OneLinkFace>(module, "OneLinkArm", "One-link arm with bristle friction; `measured` is a view.")
        .def(py::init([](const std::vector<double>& params) {
                 return new OneLinkFace(checked(params, hd_sim::OneLinkParams::size(1)));
             }),
             py::arg("params"))
        .def("advance", &OneLinkFace::advance, py::arg("motor_torque"), py::arg("dt"), py::arg("steps"))
        .def_readonly("measured", &OneLinkFace::measured);
}
