// hd_control._messages: join of fixed-layout messages into blocks, and messages from blocks. See message_join.hpp.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <optional>
#include <stdexcept>

#include "message_join.hpp"

namespace py = pybind11;
using Array = py::array_t<double, py::array::c_style>;

namespace {

std::string_view view(const py::bytes& data) {
    char* start = nullptr;
    Py_ssize_t size = 0;
    if (PyBytes_AsStringAndSize(data.ptr(), &start, &size) != 0) throw py::error_already_set();
    return {start, static_cast<std::size_t>(size)};
}

class JoinBinding {
   public:
    explicit JoinBinding(std::int64_t dt_ns) : join_(dt_ns) {
        if (dt_ns <= 0) throw std::invalid_argument("the period must be positive");
    }

    // `offsets[i]` is the byte offset of the double that goes to `target[places[i]]`, the tick goes to `ticks[tick_place]`.
    void add(const std::string& fixed, const std::string& mask, std::size_t stamp_at, std::size_t frame_at,
             std::size_t frame_length, const std::vector<std::size_t>& offsets, const std::vector<Array>& targets,
             const std::vector<std::size_t>& places, bool optional, const std::optional<Array>& ticks,
             std::size_t tick_place) {
        hd::Input input;
        const std::size_t size = fixed.size();
        if (mask.size() != size || stamp_at + 8 > size || frame_at + frame_length > size) {
            throw std::invalid_argument("the layout lies outside its message");
        }
        if (offsets.size() != targets.size() || offsets.size() != places.size()) {
            throw std::invalid_argument("offsets, targets and places differ in length");
        }
        input.layout = {fixed, mask, stamp_at, frame_at, frame_length};
        for (std::size_t i = 0; i < offsets.size(); ++i) {
            Array target = targets[i];
            if (offsets[i] + sizeof(double) > size || places[i] >= static_cast<std::size_t>(target.size())) {
                throw std::invalid_argument("a copy lies outside its message or its block");
            }
            input.copies.push_back({offsets[i], target.mutable_data() + places[i]});
            kept_.push_back(target);
        }
        if (ticks) {
            Array target = *ticks;
            if (tick_place >= static_cast<std::size_t>(target.size())) throw std::invalid_argument("no such tick");
            input.tick_to = target.mutable_data() + tick_place;
            kept_.push_back(target);
        }
        input.unseen = optional;
        join_.inputs.push_back(input);
    }

    int offer(std::size_t index, const py::bytes& data) {
        if (index >= join_.inputs.size()) throw std::out_of_range("no such input");
        return join_.offer(index, view(data));
    }

    std::size_t last_missing() const { return join_.last_missing(); }
    bool seen(std::size_t index) const { return !join_.inputs.at(index).unseen; }
    std::int64_t tick() const { return join_.tick; }
    std::int64_t incomplete() const { return join_.incomplete; }
    std::int64_t stale() const { return join_.stale; }
    std::int64_t ahead() const { return join_.ahead; }

   private:
    hd::Join join_;
    std::vector<Array> kept_;  // keeps the blocks alive
};

class MessageBinding {
   public:
    MessageBinding(const std::string& bytes, std::size_t stamp_at,
                   const std::vector<std::pair<std::size_t, std::size_t>>& copies) {
        message_.bytes = bytes;
        message_.stamp_at = stamp_at;
        message_.copies = copies;
        if (stamp_at + 8 > bytes.size()) throw std::invalid_argument("the stamp lies outside the message");
        for (const auto& [to, from] : copies) {
            if (to + sizeof(double) > bytes.size()) throw std::invalid_argument("a copy lies outside the message");
            if (from >= needed_) needed_ = from + 1;
        }
    }

    py::bytes encode(std::int64_t stamp_ns, const Array& source) {
        if (static_cast<std::size_t>(source.size()) < needed_) throw std::invalid_argument("the block is too short");
        message_.stamp(stamp_ns);
        const double* numbers = source.data();
        for (const auto& [to, from] : message_.copies) {
            std::memcpy(message_.bytes.data() + to, numbers + from, sizeof(double));
        }
        return py::bytes(message_.bytes);
    }

   private:
    hd::Message message_;
    std::size_t needed_ = 0;
};

}  // namespace

PYBIND11_MODULE(_messages, m) {
    m.doc() = "Fixed-layout messages: joined by tick into blocks, and made from blocks.";
    m.attr("STORED") = static_cast<int>(hd::kStored);
    m.attr("COMPLETE") = static_cast<int>(hd::kComplete);
    m.attr("OTHER_LAYOUT") = static_cast<int>(hd::kOtherLayout);
    m.attr("FOREIGN") = static_cast<int>(hd::kForeign);
    m.attr("STALE") = static_cast<int>(hd::kStale);
    m.attr("REPEATED") = static_cast<int>(hd::kRepeated);
    m.attr("AHEAD") = static_cast<int>(hd::kAhead);
    py::class_<JoinBinding>(m, "Join")
        .def(py::init<std::int64_t>(), py::arg("dt_ns"))
        .def("add", &JoinBinding::add, py::arg("fixed"), py::arg("mask"), py::arg("stamp_at"), py::arg("frame_at"),
             py::arg("frame_length"), py::arg("offsets"), py::arg("targets"), py::arg("places"),
             py::arg("optional") = false, py::arg("ticks") = py::none(), py::arg("tick_place") = 0)
        .def("offer", &JoinBinding::offer)
        .def("last_missing", &JoinBinding::last_missing)
        .def("seen", &JoinBinding::seen)
        .def_property_readonly("tick", &JoinBinding::tick)
        .def_property_readonly("incomplete", &JoinBinding::incomplete)
        .def_property_readonly("stale", &JoinBinding::stale)
        .def_property_readonly("ahead", &JoinBinding::ahead);
    py::class_<MessageBinding>(m, "Message")
        .def(py::init<const std::string&, std::size_t, const std::vector<std::pair<std::size_t, std::size_t>>&>(),
             py::arg("template"), py::arg("stamp_at"), py::arg("copies"))
        .def("encode", &MessageBinding::encode);
}
