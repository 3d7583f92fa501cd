// Messages and commands of a loop as Python sees them: layouts, joins, what is sent, what is translated or merged.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "capsules.hpp"
#include "plane.hpp"
#include "timed.hpp"

namespace {

namespace py = pybind11;

using Runs = std::vector<std::pair<std::size_t, py::array>>;

[[noreturn]] void refuse(const char* why) { throw std::invalid_argument(why); }

// The numbers of an array, where they are: never those of a copy that a conversion made.
template <typename T>
T* memory(const py::array& array, bool written = true) {
    if (!array.dtype().is(py::dtype::of<T>())) refuse("an array of another type");
    if ((array.flags() & py::array::c_style) == 0) refuse("the numbers of an array do not lie in a row");
    if (written && !array.writeable()) refuse("an array that may not be written");
    return static_cast<T*>(const_cast<void*>(array.data()));
}

std::size_t size_of(const py::array& array) { return static_cast<std::size_t>(array.size()); }

std::string_view view(const py::bytes& data) {
    char* start = nullptr;
    Py_ssize_t size = 0;
    if (PyBytes_AsStringAndSize(data.ptr(), &start, &size) != 0) throw py::error_already_set();
    return {start, static_cast<std::size_t>(size)};
}

hd::Layout make_layout(const std::string& fixed, const std::string& mask, std::size_t stamp_at, std::size_t frame_at,
                       std::size_t frame_length) {
    const std::size_t size = fixed.size();
    if (mask.size() != size || stamp_at + 8 > size || frame_at + frame_length > size) {
        refuse("the layout lies outside its message");
    }
    return {fixed, mask, stamp_at, frame_at, frame_length};
}

hd::Outgoing make_outgoing(const std::string& bytes, std::size_t stamp_at, const Runs& runs) {
    hd::Outgoing message{bytes, stamp_at, {}};
    if (stamp_at != hd::Outgoing::kNoStamp && stamp_at + 8 > bytes.size()) refuse("the stamp lies outside the message");
    for (const auto& [to, array] : runs) {
        if (to + sizeof(double) * size_of(array) > bytes.size()) refuse("numbers lie outside the message");
        message.runs.push_back({to, memory<double>(array, false), size_of(array)});
    }
    return message;
}

// What an input of a join looks like, with where its numbers go; shared by loops and by `Join` alone.
struct InputFace {
    hd::Layout layout;
    std::vector<hd::Copy> copies;
    std::vector<py::object> kept;
    bool optional = false;
    double* tick_to = nullptr;

    InputFace(const std::string& fixed, const std::string& mask, std::size_t stamp_at, std::size_t frame_at,
              std::size_t frame_length, const std::vector<std::size_t>& offsets, const std::vector<py::array>& targets,
              const std::vector<std::size_t>& places, bool optional, const std::optional<py::array>& ticks,
              std::size_t tick_place)
        : layout(make_layout(fixed, mask, stamp_at, frame_at, frame_length)), optional(optional) {
        if (offsets.size() != targets.size() || offsets.size() != places.size()) {
            refuse("offsets, targets and places differ in length");
        }
        for (std::size_t i = 0; i < offsets.size(); ++i) {
            if (offsets[i] + sizeof(double) > fixed.size() || places[i] >= size_of(targets[i])) {
                refuse("a copy lies outside its message or its block");
            }
            copies.push_back({offsets[i], memory<double>(targets[i]) + places[i]});
            kept.push_back(targets[i]);
        }
        if (ticks) {
            if (tick_place >= size_of(*ticks)) refuse("a tick lies outside its array");
            tick_to = memory<double>(*ticks) + tick_place;
            kept.push_back(*ticks);
        }
    }
    hd::Input input() const {
        hd::Input made;
        made.layout = layout;
        made.copies = copies;
        made.unseen = optional;
        made.tick_to = tick_to;
        return made;
    }
};

class JoinFace {
  public:
    explicit JoinFace(std::int64_t dt_ns) : join_(dt_ns) {
        if (dt_ns <= 0) refuse("the period must be positive");
    }
    void add(const InputFace& face) {
        join_.inputs.push_back(face.input());
        kept_.insert(kept_.end(), face.kept.begin(), face.kept.end());
    }
    int offer(std::size_t index, const py::bytes& data) {
        if (index >= join_.inputs.size()) throw std::out_of_range("no such input");
        return join_.offer(index, view(data));
    }
    bool seen(std::size_t index) const { return !join_.inputs.at(index).unseen; }
    const hd::Join& join() const { return join_; }

  private:
    hd::Join join_;
    std::vector<py::object> kept_;
};

class MessageFace {
  public:
    MessageFace(const std::string& bytes, std::size_t stamp_at, const Runs& runs)
        : message_(make_outgoing(bytes, stamp_at, runs)) {
        for (const auto& run : runs) kept_.push_back(run.second);
    }
    py::bytes fill(std::int64_t stamp_ns) { return py::bytes(message_.fill(stamp_ns)); }

  private:
    hd::Outgoing message_;
    std::vector<py::object> kept_;
};

class TranslatorFace {
  public:
    TranslatorFace(const InputFace& input, std::vector<std::string> joints, std::string expected,
                   const std::vector<std::pair<std::size_t, std::size_t>>& fields)
        : translator_(std::move(joints), std::move(expected), input.layout, places(fields)) {}
    py::bytes translate(const py::bytes& data) { return py::bytes(std::string(translator_.translate(view(data)))); }
    const hd::Translator& get() const { return translator_; }

  private:
    static std::vector<hd::Translator::Field> places(const std::vector<std::pair<std::size_t, std::size_t>>& fields) {
        std::vector<hd::Translator::Field> made;
        for (const auto& [which, at] : fields) made.push_back({which, at});
        return made;
    }
    hd::Translator translator_;
};

// Commands for a drive side in Python, which reads them as arrays.
class TableFace {
  public:
    explicit TableFace(std::size_t joints) : table_(joints) {}
    hd::CommandTable& get() { return table_; }

  private:
    hd::CommandTable table_;
};

// The merging of commands alone.
class CommandInputFace {
  public:
    CommandInputFace(std::vector<std::string> joints, std::int64_t dt_ns, TableFace& table)
        : input_(std::move(joints), dt_ns, table.get().commands(), foreign_) {}
    void offer(const py::bytes& data) { input_.offer(view(data)); }
    hd::CommandInput& get() { return input_; }
    std::int64_t foreign() const { return foreign_.load(); }

  private:
    std::atomic<std::int64_t> foreign_{0};
    hd::CommandInput input_;
};

void bind_messages(py::module_& m) {
    m.attr("STORED") = static_cast<int>(hd::kStored);
    m.attr("COMPLETE") = static_cast<int>(hd::kComplete);
    m.attr("OTHER_LAYOUT") = static_cast<int>(hd::kOtherLayout);
    m.attr("FOREIGN") = static_cast<int>(hd::kForeign);
    m.attr("STALE") = static_cast<int>(hd::kStale);
    m.attr("REPEATED") = static_cast<int>(hd::kRepeated);
    m.attr("AHEAD") = static_cast<int>(hd::kAhead);
    m.attr("NO_STAMP") = hd::Outgoing::kNoStamp;
    py::class_<InputFace>(m, "Input")
        .def(py::init<const std::string&, const std::string&, std::size_t, std::size_t, std::size_t,
                      const std::vector<std::size_t>&, const std::vector<py::array>&, const std::vector<std::size_t>&,
                      bool, const std::optional<py::array>&, std::size_t>(),
             py::arg("fixed"), py::arg("mask"), py::arg("stamp_at"), py::arg("frame_at"), py::arg("frame_length"),
             py::arg("offsets"), py::arg("targets"), py::arg("places"), py::arg("optional") = false,
             py::arg("ticks") = py::none(), py::arg("tick_place") = 0);
    py::class_<JoinFace>(m, "Join")
        .def(py::init<std::int64_t>(), py::arg("dt_ns"))
        .def("add", &JoinFace::add)
        .def("offer", &JoinFace::offer)
        .def("last_missing", [](const JoinFace& self) { return self.join().last_missing(); })
        .def("seen", &JoinFace::seen)
        .def_property_readonly("tick", [](const JoinFace& self) { return self.join().tick; })
        .def_property_readonly("incomplete", [](const JoinFace& self) { return self.join().incomplete; })
        .def_property_readonly("stale", [](const JoinFace& self) { return self.join().stale; })
        .def_property_readonly("ahead", [](const JoinFace& self) { return self.join().ahead; });
    py::class_<MessageFace>(m, "Message")
        .def(py::init<const std::string&, std::size_t, const Runs&>(), py::arg("template"), py::arg("stamp_at"),
             py::arg("runs"))
        .def("fill", &MessageFace::fill);
    py::class_<TranslatorFace>(m, "Translator")
        .def(py::init<const InputFace&, std::vector<std::string>, std::string,
                      const std::vector<std::pair<std::size_t, std::size_t>>&>(),
             py::arg("input"), py::arg("joint_names"), py::arg("expected"), py::arg("fields"))
        .def("translate", &TranslatorFace::translate);
}

template <auto Member>
py::array array_of(const py::object& self) {
    auto& memory = self.cast<TableFace&>().get().*Member;
    using Number = typename std::decay_t<decltype(memory)>::value_type;
    return py::array_t<Number>(static_cast<py::ssize_t>(memory.size()), memory.data(), self);
}

void bind_commands(py::module_& m) {
    py::class_<TableFace>(m, "CommandTable")
        .def(py::init<std::size_t>(), py::arg("joints"))
        .def_property_readonly("torque", &array_of<&hd::CommandTable::torque>)
        .def_property_readonly("ticks", &array_of<&hd::CommandTable::tick>)
        .def_property(
            "stands", [](TableFace& self) { return self.get().stands; },
            [](TableFace& self, bool stands) { self.get().stands = stands; })
        .def_property_readonly("stale", [](TableFace& self) { return self.get().stale; })
        .def_property_readonly("strangers", [](TableFace& self) { return self.get().strangers; })
        .def("commands_capsule", [](const py::object& self) {
            hd::CommandTable& table = self.cast<TableFace&>().get();
            return hd::owned_capsule(table.commands(), hd::kCommandsCapsule, self);
        });
    py::class_<CommandInputFace>(m, "CommandInput")
        .def(py::init<std::vector<std::string>, std::int64_t, TableFace&>(), py::arg("joint_names"), py::arg("dt_ns"),
             py::arg("table"), py::keep_alive<1, 4>())
        .def("offer", &CommandInputFace::offer)
        .def("release", [](CommandInputFace& self) { self.get().release(); })
        .def_property_readonly("foreign", &CommandInputFace::foreign)
        .def_property_readonly("unreadable", [](CommandInputFace& self) { return self.get().unreadable.load(); });
}

}  // namespace
