// Python face of the monitors' arithmetic: hd_control._monitors.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <optional>
#include <stdexcept>
#include <string>
#include <tuple>
#include <vector>

#include "monitors.hpp"

namespace py = pybind11;
using Array = py::array_t<double, py::array::c_style>;

namespace {

const double* numbers(const Array& array, py::ssize_t size, const char* name) {
    if (array.size() != size) throw std::invalid_argument(std::string(name) + ": wrong number of values");
    return array.data();
}

bool all_finite(const Array& values) { return hd::all_finite(values.data(), static_cast<int>(values.size())); }

bool all_below(const Array& values, const Array& limit) {
    return hd::all_below(values.data(), numbers(limit, values.size(), "limit"), static_cast<int>(values.size()));
}

bool all_near(const Array& a, const Array& b, const Array& limit) {
    return hd::all_near(a.data(), numbers(b, a.size(), "b"), numbers(limit, a.size(), "limit"),
                        static_cast<int>(a.size()));
}

std::tuple<bool, Array> readings_follow(const Array& reading, const Array& last, const Array& slope, const Array& limit,
                                        const std::optional<Array>& period) {
    const py::ssize_t size = reading.size();
    Array new_slope(std::vector<py::ssize_t>(reading.shape(), reading.shape() + reading.ndim()));
    const bool follow = hd::readings_follow(
        reading.data(), numbers(last, size, "last"), numbers(slope, size, "slope"), numbers(limit, size, "limit"),
        period ? numbers(*period, size, "period") : nullptr, new_slope.mutable_data(), static_cast<int>(size));
    return {follow, new_slope};
}

std::tuple<bool, Array, Array, Array> sum_turn(const Array& residual, const Array& shaft, const Array& gauge_angle,
                                               const Array& last_shaft, const Array& terms, const Array& sums,
                                               const Array& travel, double whole, double longest_way,
                                               double largest_step) {
    const py::ssize_t n = residual.size();
    Array new_terms({py::ssize_t{3}, n}), new_sums({py::ssize_t{4}, n}), new_travel(n);
    const bool ordinary =
        hd::sum_turn(residual.data(), numbers(shaft, n, "shaft"), numbers(gauge_angle, n, "gauge_angle"),
                     numbers(last_shaft, n, "last_shaft"), numbers(terms, 3 * n, "terms"), numbers(sums, 4 * n, "sums"),
                     numbers(travel, n, "travel"), {whole, longest_way, largest_step}, new_terms.mutable_data(),
                     new_sums.mutable_data(), new_travel.mutable_data(), static_cast<int>(n));
    return {ordinary, new_terms, new_sums, new_travel};
}

std::tuple<bool, Array, Array, Array, Array> missed_motion(const Array& positions, const Array& twist,
                                                           const Array& reading, const Array& repeats,
                                                           const Array& expected, const Array& other, double samples,
                                                           const Array& limit, double step) {
    const py::ssize_t n = twist.size(), both = 2 * n;
    const auto pair = [n] { return Array({py::ssize_t{2}, n}); };
    Array new_repeats = pair(), new_expected = pair(), new_other = pair(), moved = pair();
    const bool ordinary = hd::missed_motion(numbers(positions, both, "positions"), twist.data(),
                                            {numbers(reading, both, "reading"), numbers(repeats, both, "repeats"),
                                             numbers(expected, both, "expected"), numbers(other, both, "other")},
                                            samples, numbers(limit, n, "limit"), step, new_repeats.mutable_data(),
                                            new_expected.mutable_data(), new_other.mutable_data(), moved.mutable_data(),
                                            static_cast<int>(n));
    return {ordinary, new_repeats, new_expected, new_other, moved};
}

std::tuple<bool, Array, Array> gauge_changes(const Array& gauge, const Array& position, const Array& reading,
                                             const Array& repeats, const Array& start, const Array& limit,
                                             double samples) {
    const py::ssize_t n = gauge.size();
    Array new_repeats(n), new_start(n);
    const bool ordinary =
        hd::gauge_changes(gauge.data(), numbers(position, n, "position"), numbers(reading, n, "reading"),
                          numbers(repeats, n, "repeats"), numbers(start, n, "start"), numbers(limit, n, "limit"),
                          samples, new_repeats.mutable_data(), new_start.mutable_data(), static_cast<int>(n));
    return {ordinary, new_repeats, new_start};
}

bool guard_is_quiet(const Array& command, const Array& ages, const Array& ticks, const Array& last_tick,
                    const Array& position, const Array& velocity, const Array& low, const Array& high,
                    const Array& speed, const Array& twice_deceleration, double age_limit, double largest_tick) {
    const py::ssize_t n = command.size();
    const hd::GuardLook look{command.data(),
                             numbers(ages, n, "ages"),
                             numbers(ticks, n, "ticks"),
                             numbers(last_tick, n, "last_tick"),
                             numbers(position, n, "position"),
                             numbers(velocity, n, "velocity"),
                             numbers(low, n, "low"),
                             numbers(high, n, "high"),
                             numbers(speed, n, "speed"),
                             numbers(twice_deceleration, n, "twice_deceleration"),
                             age_limit,
                             largest_tick};
    return hd::guard_is_quiet(look, static_cast<int>(n));
}

}  // namespace

PYBIND11_MODULE(_monitors, module) {
    module.doc() = "Arithmetic of the sensor monitors; the guard's look at an ordinary sample.";
    module.def("all_finite", &all_finite, "Is every value a finite number?");
    module.def("all_below", &all_below, "|values| < limit everywhere?");
    module.def("all_near", &all_near, "|a - b| <= limit everywhere?");
    module.def("readings_follow", &readings_follow, "Readings near their prediction, and the new slope.");
    module.def("sum_turn", &sum_turn, "One step of the integrals over a motor turn: ordinary, terms, sums, travel.");
    module.def("missed_motion", &missed_motion, "Ordinary, repeats, expected, other, motion missed.");
    module.def("gauge_changes", &gauge_changes, "Ordinary, repeats, motor position when they began.");
    module.def("guard_is_quiet", &guard_is_quiet, "Does the guard have nothing to say about this sample?");
}
