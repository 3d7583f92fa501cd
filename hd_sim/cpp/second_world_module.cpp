// Python face of the second world: hd_sim._second_world.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <stdexcept>

#include "second_recorder.hpp"

namespace py = pybind11;
using Array = py::array_t<double, py::array::c_style | py::array::forcecast>;

namespace {

hd_second::Params read(const Array& values) {
    if (values.size() != static_cast<py::ssize_t>(hd_second::Params::fields().size()))
        throw std::invalid_argument("params: wrong number of values");
    return hd_second::Params(values.data());
}

py::tuple record(const Array& params, const hd_second::Windows& windows, const Array& position, const Array& rate,
                 const Array& draws, double period, int substeps) {
    const py::ssize_t n = position.size();
    if (n < 2 || rate.size() != n || draws.size() != n * hd_second::DRAWS)
        throw std::invalid_argument("position (n,), rate (n,) and draws (n, 8) do not fit");
    if (substeps < 4 || substeps % 4 != 0 || !(period > 0.0)) throw std::invalid_argument("substeps: a multiple of 4");
    py::array_t<double> readings({n, static_cast<py::ssize_t>(hd_second::READINGS)});
    py::array_t<double> truths({n, static_cast<py::ssize_t>(hd_second::TRUTHS)});
    hd_second::Recorder recorder(read(params), windows, period, substeps);
    const double *q = position.data(), *v = rate.data(), *w = draws.data();
    double *to = readings.mutable_data(), *seen = truths.mutable_data();
    {
        py::gil_scoped_release release;
        recorder.run(static_cast<int>(n), q, v, w, to, seen);
    }
    return py::make_tuple(readings, truths);
}

// Steady sliding friction and what grows with the speed, at states (n,).
py::tuple friction(const Array& params, const Array& v, const Array& load, const Array& angle, const Array& warm,
                   const Array& time) {
    const py::ssize_t n = v.size();
    if (load.size() != n || angle.size() != n || warm.size() != n || time.size() != n)
        throw std::invalid_argument("states of different lengths");
    const hd_second::Joint joint(read(params), {});
    py::array_t<double> slide(n), fluid(n);
    for (py::ssize_t i = 0; i < n; ++i) {
        slide.mutable_data()[i] = joint.sliding(v.data()[i], load.data()[i], angle.data()[i], time.data()[i]);
        fluid.mutable_data()[i] = joint.fluid(v.data()[i], load.data()[i], angle.data()[i], warm.data()[i]);
    }
    return py::make_tuple(slide, fluid);
}

// Torque of the wound spring at torsions (n,).
py::array_t<double> elastic(const Array& params, const Array& torsion) {
    const hd_second::Joint joint(read(params), {});
    py::array_t<double> torque(torsion.size());
    for (py::ssize_t i = 0; i < torsion.size(); ++i) torque.mutable_data()[i] = joint.elastic(torsion.data()[i]);
    return torque;
}

// Output (n, outputs) of s+ = A s + b f, e = C s + d f from rest; A (m, m), C (outputs, m).
py::array_t<double> filtered(const Array& a, const Array& b, const Array& c, const Array& d, const Array& f) {
    const py::ssize_t m = b.size(), outputs = d.size(), n = f.size();
    if (a.size() != m * m || c.size() != outputs * m) throw std::invalid_argument("matrices do not fit");
    py::array_t<double> result({n, outputs});
    const double *pa = a.data(), *pb = b.data(), *pc = c.data(), *pd = d.data(), *in = f.data();
    double* out = result.mutable_data();
    std::vector<double> s(static_cast<std::size_t>(m), 0.0), next(s);
    for (py::ssize_t k = 0; k < n; ++k) {
        for (py::ssize_t i = 0; i < outputs; ++i) {
            double sum = pd[i] * in[k];
            for (py::ssize_t j = 0; j < m; ++j) sum += pc[i * m + j] * s[j];
            *out++ = sum;
        }
        for (py::ssize_t i = 0; i < m; ++i) {
            next[i] = pb[i] * in[k];
            for (py::ssize_t j = 0; j < m; ++j) next[i] += pa[i * m + j] * s[j];
        }
        s.swap(next);
    }
    return result;
}

std::vector<double> listed(const hd_second::State& state) { return {state.begin(), state.end()}; }

}  // namespace

PYBIND11_MODULE(_second_world, module) {
    module.doc() = "One joint in laws of its own, recorded under a controller; see hd_sim/second_world.";
    py::list fields;
    for (const hd::Field& field : hd_second::Params::fields())
        fields.append(py::make_tuple(field.name, field.unit, field.meaning));
    module.attr("FIELDS") = fields;
    module.attr("DRAWS") = static_cast<int>(hd_second::DRAWS);
    module.def("record", &record, py::arg("params"), py::arg("windows"), py::arg("position"), py::arg("rate"),
               py::arg("draws"), py::arg("period"), py::arg("substeps"));
    module.def("friction", &friction, py::arg("params"), py::arg("v"), py::arg("load"), py::arg("angle"),
               py::arg("warm"), py::arg("time"));
    module.def("filtered", &filtered, py::arg("a"), py::arg("b"), py::arg("c"), py::arg("d"), py::arg("f"));
    module.def("elastic", &elastic, py::arg("params"), py::arg("torsion"));
    py::class_<hd_second::Joint>(module, "Joint", "The joint alone, moved by a set-point.")
        .def(py::init([](const Array& params, const hd_second::Windows& windows) {
                 return new hd_second::Joint(read(params), windows);
             }),
             py::arg("params"), py::arg("windows") = hd_second::Windows{})
        .def("rest", &hd_second::Joint::rest, py::arg("angle"))
        .def(
            "step",
            [](hd_second::Joint& joint, double h, double set_point, int steps) {
                for (int i = 0; i < steps; ++i) joint.step(h, set_point);
            },
            py::arg("h"), py::arg("set_point"), py::arg("steps"))
        .def(
            "place",
            [](hd_second::Joint& joint, const std::vector<double>& values) {
                if (values.size() != hd_second::SIZE) throw std::invalid_argument("state: wrong number of values");
                std::copy(values.begin(), values.end(), joint.state().begin());
            },
            py::arg("state"))
        .def("torques",
             [](const hd_second::Joint& joint) {
                 hd_second::Torques t;
                 joint.rates(joint.state(), joint.time(), 0.0, {}, t);
                 return std::vector<double>{t.joint, t.friction, t.motor, t.torsion};
             })
        .def("energy", &hd_second::Joint::energy)
        .def_property_readonly("state", [](const hd_second::Joint& joint) { return listed(joint.state()); })
        .def_property_readonly("time", &hd_second::Joint::time);
    module.def("bristle_rate", &hd_second::bristle_rate, py::arg("z"), py::arg("v"), py::arg("steady"),
               py::arg("share"));
    module.def("bouc_wen_rate", &hd_second::bouc_wen_rate, py::arg("w"), py::arg("rate"), py::arg("travel"),
               py::arg("shape"), py::arg("exponent"));
}
