// Python module hd_control._innovations: the filter of one joint, and many columns sent through it.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <optional>

#include "innovations.hpp"

namespace py = pybind11;
namespace in = hd::innovations;

namespace {

using Array = py::array_t<double, py::array::c_style | py::array::forcecast>;
using Flags = py::array_t<bool, py::array::c_style | py::array::forcecast>;

in::Filter make_filter(const in::Joint& joint, const Array& inertia, const Array& sensor, const Array& force, const Flags& valid,
                       const std::vector<double>& start) {
    const auto samples = static_cast<std::size_t>(valid.size());
    if (static_cast<std::size_t>(sensor.size()) != samples * in::SENSORS || start.size() != in::STATES || static_cast<std::size_t>(force.size()) != samples * in::FORCES ||
        (inertia.size() != 1 && static_cast<std::size_t>(inertia.size()) != samples))
        throw py::value_error("filter: sizes do not agree");
    in::Filter filter;
    filter.samples = samples;
    filter.constant = inertia.size() == 1;
    filter.c = joint.sensors();
    in::Noise noise;
    for (std::size_t s = 0; s < in::SENSORS; ++s)
        if (std::isfinite(sensor.data()[s])) filter.which[filter.present++] = s;  // a sensor that is not there has no finite noise
    noise.sensor = sensor.data();
    noise.force = force.data();
    noise.valid = valid.data();
    const double* inertias = inertia.data();
    py::gil_scoped_release release;
    filter.steps.resize(filter.constant ? 1 : samples);
    for (std::size_t k = 0; k < filter.steps.size(); ++k) filter.steps[k] = in::step_of(joint, inertias[k]);
    filter.gain.assign(samples * in::STATES * in::SENSORS, 0.0);
    filter.white.assign(samples * in::SENSORS * in::SENSORS, 0.0);
    in::Matrix p{};
    for (std::size_t i = 0; i < in::STATES; ++i) p[i * in::STATES + i] = start[i] * start[i];
    for (std::size_t k = 0; k < samples; ++k) in::covariance_step(filter, k, noise, p);
    return filter;
}

// What drives the filter, (samples, k) each; the ones that are there have the same k.
struct Columns {
    std::optional<Array> rotor, link, angle, motor_sensor, joint_sensor, torque_sensor;
    bool stamped;  // the sensor columns are values at the stamps; else, as the others, of the middle of each sample

    [[nodiscard]] std::size_t width(std::size_t samples) const {
        std::size_t width = 0;
        for (const auto* columns : {&rotor, &link, &angle, &motor_sensor, &joint_sensor, &torque_sensor}) {
            if (!*columns) continue;
            if ((*columns)->ndim() != 2 || static_cast<std::size_t>((*columns)->shape(0)) != samples)
                throw py::value_error("respond: columns are (samples, k)");
            const auto mine = static_cast<std::size_t>((*columns)->shape(1));
            if (width != 0 && mine != width) throw py::value_error("respond: columns differ in width");
            width = mine;
        }
        return width;
    }
};

// W columns of a (samples, k) array from `at` on, or null; `back`: the mean of each sample and the one before, which
// brings a value of the middle of a sample to its stamp.
template <std::size_t W>
const double* lanes(const std::optional<Array>& columns, std::size_t at, bool back, std::vector<double>& room) {
    if (!columns) return nullptr;
    const auto samples = static_cast<std::size_t>(columns->shape(0)), width = static_cast<std::size_t>(columns->shape(1));
    room.resize(samples * W);
    const double* from = columns->data() + at;
    for (std::size_t k = 0; k < samples; ++k, from += width) {
        const double* before = back && k > 0 ? from - width : from;
        for (std::size_t n = 0; n < W; ++n) room[k * W + n] = back ? 0.5 * (from[n] + before[n]) : from[n];
    }
    return room.data();
}

struct Rows {
    const std::vector<double>& taps;
    std::size_t stride, rows, width;
    double* out;  // (present, rows, width)
};

// Innovations of W columns, low-pass filtered by the taps, every stride-th sample.
template <std::size_t W>
void respond_some(const in::Filter& filter, const Columns& columns, std::size_t at, const Rows& to) {
    std::array<std::vector<double>, 7> room;
    in::Drive drive;
    const bool back = !columns.stamped;
    drive.rotor = lanes<W>(columns.rotor, at, false, room[0]);
    drive.link = lanes<W>(columns.link, at, false, room[1]);
    drive.spring = lanes<W>(columns.angle, at, false, room[2]);
    drive.now = lanes<W>(columns.angle, at, true, room[3]);
    drive.sensor = {lanes<W>(columns.motor_sensor, at, back, room[4]), lanes<W>(columns.joint_sensor, at, back, room[5]),
                    lanes<W>(columns.torque_sensor, at, back, room[6])};
    const std::size_t m = filter.present;
    std::vector<double> white(filter.samples * m * W);
    in::respond<W>(filter, drive, white.data(), nullptr);
    const auto half = static_cast<std::ptrdiff_t>(to.taps.size() / 2), samples = static_cast<std::ptrdiff_t>(filter.samples);
    for (std::size_t r = 0; r < to.rows; ++r) {
        double sums[in::SENSORS][W] = {};
        const auto middle = static_cast<std::ptrdiff_t>(r * to.stride);
        const std::ptrdiff_t first = std::max<std::ptrdiff_t>(0, middle - half), last = std::min(samples - 1, middle + half);
        for (std::ptrdiff_t k = first; k <= last; ++k) {
            const double tap = to.taps[static_cast<std::size_t>(k - middle + half)];
            const double* row = &white[static_cast<std::size_t>(k) * m * W];
            for (std::size_t a = 0; a < m; ++a)
                for (std::size_t n = 0; n < W; ++n) sums[a][n] += tap * row[a * W + n];
        }
        for (std::size_t a = 0; a < m; ++a)
            for (std::size_t n = 0; n < W; ++n) to.out[(a * to.rows + r) * to.width + at + n] = sums[a][n];
    }
}

// (samples, 4): the state that the filter predicts at each stamp from everything before, for one column of each input.
py::array_t<double> predict(const in::Filter& filter, const Columns& columns) {
    if (columns.width(filter.samples) != 1) throw py::value_error("predict: one column");
    py::array_t<double> found({filter.samples, in::STATES});
    std::array<std::vector<double>, 7> room;
    in::Drive drive;
    drive.rotor = lanes<1>(columns.rotor, 0, false, room[0]);
    drive.link = lanes<1>(columns.link, 0, false, room[1]);
    drive.spring = lanes<1>(columns.angle, 0, false, room[2]);
    drive.now = lanes<1>(columns.angle, 0, true, room[3]);
    drive.sensor = {lanes<1>(columns.motor_sensor, 0, false, room[4]), lanes<1>(columns.joint_sensor, 0, false, room[5]),
                    lanes<1>(columns.torque_sensor, 0, false, room[6])};
    std::vector<double> white(filter.samples * filter.present);
    in::respond<1>(filter, drive, white.data(), found.mutable_data());
    double* z = found.mutable_data();
    for (std::size_t i = 0; i < filter.samples * in::STATES; ++i) z[i] = -z[i];
    return found;
}

// (present, rows, k): white innovations that the columns cause.
py::array_t<double> respond(const in::Filter& filter, const Columns& columns, const std::vector<double>& taps, std::size_t stride) {
    if (taps.size() % 2 == 0 || stride == 0) throw py::value_error("respond: an odd number of taps and a stride of at least 1");
    const std::size_t width = columns.width(filter.samples), rows = (filter.samples + stride - 1) / stride;
    py::array_t<double> found({filter.present, rows, width});
    const Rows to{taps, stride, rows, width, found.mutable_data()};
    py::gil_scoped_release release;
    for (std::size_t at = 0; at < width;) {
        const std::size_t left = width - at;
        if (left >= 8) respond_some<8>(filter, columns, at, to), at += 8;
        else if (left >= 4) respond_some<4>(filter, columns, at, to), at += 4;
        else if (left >= 2) respond_some<2>(filter, columns, at, to), at += 2;
        else respond_some<1>(filter, columns, at, to), at += 1;
    }
    return found;
}

}  // namespace

PYBIND11_MODULE(_innovations, module) {
    module.doc() = "Kalman filter of one joint and the responses of its innovations.";
    py::class_<in::Joint>(module, "Joint")
        .def(py::init([](double inertia, double stiffness, double damping, double period) {
                 if (!(inertia > 0.0 && stiffness > 0.0 && damping >= 0.0 && period > 0.0))
                     throw py::value_error("joint: inertia, stiffness and period are positive");
                 return in::Joint{inertia, stiffness, damping, period};
             }),
             py::arg("rotor_inertia"), py::arg("stiffness"), py::arg("damping"), py::arg("period"))
        .def("step", [](const in::Joint& joint, double link_inertia) {
            const in::Step step = in::step_of(joint, link_inertia);
            return py::make_tuple(py::array_t<double>({in::STATES, in::STATES}, step.f.data()), py::array_t<double>({in::STATES, in::FORCES}, step.g.data()));
        });
    py::class_<in::Filter>(module, "Filter")
        .def(py::init(&make_filter), py::arg("joint"), py::arg("link_inertia"), py::arg("sensor_variance"), py::arg("force_variance"), py::arg("valid"),
             py::arg("start"))
        .def_readonly("present", &in::Filter::present)
        .def_property_readonly("which", [](const in::Filter& f) { return std::vector<std::size_t>(f.which.begin(), f.which.begin() + static_cast<std::ptrdiff_t>(f.present)); })
        .def("predict",
             [](const in::Filter& filter, std::optional<Array> rotor, std::optional<Array> link, std::optional<Array> angle, std::optional<Array> motor_sensor,
                std::optional<Array> joint_sensor, std::optional<Array> torque_sensor) {
                 return predict(filter, Columns{rotor, link, angle, motor_sensor, joint_sensor, torque_sensor, true});
             },
             py::arg("rotor") = py::none(), py::arg("link") = py::none(), py::arg("angle") = py::none(), py::arg("motor_sensor") = py::none(),
             py::arg("joint_sensor") = py::none(), py::arg("torque_sensor") = py::none())
        .def("whitening", [](const in::Filter& f) { return py::array_t<double>({f.samples, in::SENSORS, in::SENSORS}, f.white.data()); })
        .def("respond",
             [](const in::Filter& filter, const std::vector<double>& taps, std::size_t stride, bool stamped, std::optional<Array> rotor,
                std::optional<Array> link, std::optional<Array> angle, std::optional<Array> motor_sensor, std::optional<Array> joint_sensor,
                std::optional<Array> torque_sensor) {
                 return respond(filter, Columns{rotor, link, angle, motor_sensor, joint_sensor, torque_sensor, stamped}, taps, stride);
             },
             py::arg("taps"), py::arg("stride"), py::arg("stamped") = false, py::arg("rotor") = py::none(), py::arg("link") = py::none(),
             py::arg("angle") = py::none(), py::arg("motor_sensor") = py::none(), py::arg("joint_sensor") = py::none(), py::arg("torque_sensor") = py::none());
}
