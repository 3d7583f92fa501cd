// hd_control._plane: loops that take, join, step and publish without the interpreter. See plane.hpp and timed.hpp.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cerrno>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "capsules.hpp"
#include "message_faces.hpp"
#include "plane.hpp"
#include "timed.hpp"

namespace py = pybind11;

namespace {

// A step in Python: takes the interpreter lock, so the loop is not real time. What it raises ends the loop.
struct PythonStep {
    py::object function;
    hd::Failure* failure;

    static void run(void* context, std::int64_t tick) {
        auto* step = static_cast<PythonStep*>(context);
        const py::gil_scoped_acquire lock;
        try {
            step->function(tick);
        } catch (...) {
            step->failure->what = std::current_exception();
            step->failure->raised.store(true);
        }
    }
};

// What keeps alive what a loop points to, until `close`.
class Keeper {
  public:
    // The rcl entity behind an entity of rclpy; rclpy does not destroy it before `release`.
    const void* entity(const py::object& handle) {
        handle.attr("__enter__")();
        handles_.push_back(handle);
        return reinterpret_cast<const void*>(handle.attr("pointer").cast<std::uintptr_t>());
    }
    double* numbers(const py::array& array, bool written) {
        objects.push_back(array);
        return memory<double>(array, written);
    }
    template <typename T>
    T from_capsule(const py::object& given, const char* name) {
        objects.push_back(given);
        return hd::in_capsule<T>(given, name);
    }
    hd::Step step(const py::object& given, hd::Failure& failure) {
        if (PyCapsule_IsValid(given.ptr(), hd::kStepCapsule) != 0) {
            return from_capsule<hd::Step>(given, hd::kStepCapsule);
        }
        if (PyCallable_Check(given.ptr()) == 0) refuse("a step is a function or a capsule");
        python_steps_.push_back(std::make_unique<PythonStep>(PythonStep{given, &failure}));
        return {python_steps_.back().get(), &PythonStep::run};
    }
    bool has_python_steps() const { return !python_steps_.empty(); }

    void release() {
        for (const py::object& handle : handles_) handle.attr("__exit__")(py::none(), py::none(), py::none());
        handles_.clear(), objects.clear(), python_steps_.clear();
    }

    std::vector<py::object> objects;

  private:
    std::vector<py::object> handles_;
    std::vector<std::unique_ptr<PythonStep>> python_steps_;
};

class ProgramFace {
  public:
    ProgramFace(hd::Program& program, Keeper& keeper, hd::Failure& failure)
        : program_(program), keeper_(keeper), failure_(failure) {}
    ProgramFace(const ProgramFace&) = delete;
    ProgramFace& operator=(const ProgramFace&) = delete;
    void copy(const py::array& from, const py::array& to) {
        if (from.size() != to.size()) refuse("source and target of a copy differ in length");
        program_.parts.emplace_back(
            hd::CopyNumbers{keeper_.numbers(from, false), keeper_.numbers(to, true), size_of(from)});
    }
    void step(const py::object& given) { program_.parts.emplace_back(keeper_.step(given, failure_)); }
    void send(hd::Outbox& outbox) { program_.parts.emplace_back(&outbox); }
    void announce(hd::Outbox& outbox, const py::object& reading, std::vector<std::string> messages) {
        announcements_.push_back(std::make_unique<hd::Announcement>(hd::Announcement{
            &outbox, keeper_.from_capsule<hd::Reading>(reading, hd::kReadingCapsule), std::move(messages)}));
        program_.parts.emplace_back(announcements_.back().get());
    }
    hd::Program& get() { return program_; }
    void clear() { program_.parts.clear(), announcements_.clear(); }

  private:
    hd::Program& program_;
    Keeper& keeper_;
    hd::Failure& failure_;
    std::vector<std::unique_ptr<hd::Announcement>> announcements_;
};

class LoopFace {
  public:
    explicit LoopFace(hd::Loop& loop) : loop_(loop) {}
    LoopFace(const LoopFace&) = delete;
    LoopFace& operator=(const LoopFace&) = delete;
    virtual ~LoopFace() = default;

    void run() {
        const py::gil_scoped_release released;
        loop_.run();
    }
    void close() {
        {
            const py::gil_scoped_release released;
            loop_.close();
        }
        for (ProgramFace* program : programs()) program->clear();
        keeper_.release();
    }
    hd::Outbox& outbox(const py::object& handle, const std::string& bytes, std::size_t stamp_at, const Runs& runs) {
        for (const auto& run : runs) keeper_.objects.push_back(run.second);
        outboxes_.push_back(std::make_unique<hd::Outbox>(keeper_.entity(handle), make_outgoing(bytes, stamp_at, runs)));
        return *outboxes_.back();
    }
    // Runs `change` between two ticks, without the interpreter lock.
    template <typename Change>
    void quietly(Change&& change) {
        const py::gil_scoped_release released;
        change();
    }
    bool real_time() const { return !keeper_.has_python_steps(); }
    hd::Loop& loop() { return loop_; }

  protected:
    static constexpr std::size_t kCapacity = 4096;  // bytes; a message of seven joints has less than 500
    virtual std::vector<ProgramFace*> programs() = 0;
    Keeper keeper_;

  private:
    hd::Loop& loop_;
    std::vector<std::unique_ptr<hd::Outbox>> outboxes_;
};

class JoinedFace : public LoopFace {
  public:
    JoinedFace(std::int64_t dt_ns, bool poll) : LoopFace(loop_), loop_(dt_ns, poll) {
        if (dt_ns <= 0) refuse("the period must be positive");
    }
    ~JoinedFace() override { close(); }
    JoinedFace(const JoinedFace&) = delete;
    JoinedFace& operator=(const JoinedFace&) = delete;

    void add_input(const py::object& handle, const InputFace& input, const TranslatorFace& translator) {
        keeper_.objects.insert(keeper_.objects.end(), input.kept.begin(), input.kept.end());
        loop_.add_input(loop_.add_inbox(keeper_.entity(handle), kCapacity), input.input(), translator.get());
    }
    void add_slow(const py::object& handle,
                  const std::vector<std::pair<InputFace, std::vector<std::pair<py::array, std::size_t>>>>& rows) {
        hd::SlowInput slow{&loop_.add_inbox(keeper_.entity(handle), kCapacity), {}};
        for (const auto& [input, targets] : rows) {
            hd::SlowInput::Row row{input.layout, input.copies.at(0).from, {}};
            for (const auto& [array, place] : targets) {
                if (place >= size_of(array)) refuse("a target lies outside its block");
                row.targets.push_back(keeper_.numbers(array, true) + place);
            }
            slow.rows.push_back(std::move(row));
        }
        loop_.add_slow(std::move(slow));
    }
    void substitute(std::size_t input, const py::array& to, const py::object& from) {
        const double* source = nullptr;
        if (!from.is_none()) {
            const auto array = from.cast<py::array>();
            if (array.size() != to.size()) refuse("source and target of a substitute differ in length");
            source = keeper_.numbers(array, false);
        }
        loop_.substitute(input, source, keeper_.numbers(to, true), size_of(to));
    }
    hd::JoinedLoop& get() { return loop_; }

  private:
    hd::JoinedLoop loop_;

  public:
    ProgramFace program{loop_.program, keeper_, loop_.failure}, again{loop_.again, keeper_, loop_.failure};

  protected:
    std::vector<ProgramFace*> programs() override { return {&program, &again}; }
};

class TimedFace : public LoopFace {
  public:
    TimedFace(std::int64_t dt_ns, bool lockstep, std::int64_t recorder_lag, std::int64_t temperature_ticks, int joints,
              const py::object& commands)
        : LoopFace(loop_),
          loop_(dt_ns, {lockstep, recorder_lag, temperature_ticks}, joints,
                keeper_.from_capsule<hd::Commands>(commands, hd::kCommandsCapsule)) {
        if (dt_ns <= 0 || temperature_ticks <= 0) refuse("periods must be positive");
    }
    ~TimedFace() override { close(); }
    TimedFace(const TimedFace&) = delete;
    TimedFace& operator=(const TimedFace&) = delete;

    void listen(const py::object& handle, std::vector<std::string> joints) {
        if (static_cast<int>(joints.size()) != loop_.joints) refuse("names and commands differ in length");
        input_ = std::make_unique<hd::CommandInput>(std::move(joints), loop_.dt_ns, loop_.commands,
                                                    loop_.statistics.foreign);
        loop_.listen(loop_.add_inbox(keeper_.entity(handle), kCapacity), *input_);
    }
    void follow_recorder(const py::object& handle) {
        loop_.follow_recorder(loop_.add_inbox(keeper_.entity(handle), kCapacity));
    }
    void set_steps(const py::object& measure, const py::object& advance) {
        loop_.measure = keeper_.step(measure, loop_.failure);
        loop_.advance = keeper_.step(advance, loop_.failure);
    }
    // Commands of the same process: at this place of `send` they are handed on.
    void offer(const py::array& torque) {
        if (static_cast<int>(size_of(torque)) != loop_.joints) refuse("a command for another number of joints");
        own_ = {loop_.commands, keeper_.numbers(torque, false), {}};
        for (int j = 0; j < loop_.joints; ++j) own_.joints.push_back(j);
        loop_.send.parts.emplace_back(hd::Step{&own_, &hd::OwnCommand::run});
    }
    std::int64_t unreadable() const { return input_ == nullptr ? 0 : input_->unreadable.load(); }
    hd::TimedLoop& get() { return loop_; }

  private:
    hd::TimedLoop loop_;
    std::unique_ptr<hd::CommandInput> input_;
    hd::OwnCommand own_{};

  public:
    ProgramFace send{loop_.send, keeper_, loop_.failure}, temperature{loop_.temperature, keeper_, loop_.failure};

  protected:
    std::vector<ProgramFace*> programs() override { return {&send, &temperature}; }
};

py::dict summary(hd::Statistics& statistics) {
    py::dict found;
    const auto count = [&](const char* name, const std::atomic<std::int64_t>& counter) {
        found[name] = counter.load();
    };
    count("ticks", statistics.ticks), count("missed", statistics.missed);
    count("incomplete", statistics.incomplete), count("foreign", statistics.foreign);
    count("ahead", statistics.ahead);
    found["max_age_us"] = static_cast<double>(statistics.oldest_ns.exchange(0)) / 1000.0;
    const auto spread = [&](const std::string& name, const auto& ring, std::int64_t written, bool differences) {
        std::array<double, 3> values{};
        if (!statistics.spread(ring, written, differences, values)) return;
        const char* labels[] = {"p50", "p99", "max"};
        for (std::size_t i = 0; i < values.size(); ++i) found[(name + "_" + labels[i] + "_us").c_str()] = values[i];
    };
    const std::int64_t ticks = statistics.ticks.load();
    if (ticks > 2) {
        spread("period", statistics.times, ticks, true);
        spread("busy", statistics.busy, ticks, false);
    }
    spread("answer", statistics.answers, statistics.answers_given.load(), false);
    return found;
}

// The answers given since the first `count`, ns, as far as they are still there; and how many there were in all.
py::tuple answers_after(const hd::Statistics& statistics, std::int64_t count) {
    const std::int64_t all = statistics.answers_given.load();
    const std::int64_t ring = hd::Statistics::kRing;
    std::vector<std::int64_t> found;
    for (std::int64_t i = std::max({count, all - ring, std::int64_t{0}}); i < all; ++i) {
        found.push_back(statistics.answers[static_cast<std::size_t>(i % ring)].load());
    }
    return py::make_tuple(all, found);
}

// How late a thread wakes that does nothing but sleep, ns per tick: what the machine itself does to every loop.
py::array_t<std::int64_t> bare_loop(std::int64_t period_ns, std::size_t ticks) {
    if (period_ns <= 0) refuse("the period must be positive");
    py::array_t<std::int64_t> late(static_cast<py::ssize_t>(ticks));
    std::int64_t* found = late.mutable_data();
    const py::gil_scoped_release released;
    std::int64_t deadline = hd::steady_ns();
    for (std::size_t i = 0; i < ticks; ++i) {
        deadline += period_ns;
        const timespec until{static_cast<time_t>(deadline / 1000000000), static_cast<long>(deadline % 1000000000)};
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {}
        found[i] = hd::steady_ns() - deadline;
    }
    return late;
}

void bind_parts(py::module_& m) {
    m.def("bare_loop", &bare_loop, py::arg("period_ns"), py::arg("ticks"));
    py::class_<hd::Statistics>(m, "Statistics")
        .def(py::init<>())
        .def("tick", &hd::Statistics::tick)
        .def("answer", &hd::Statistics::answer)
        .def("age", &hd::Statistics::age)
        .def_property(
            "foreign", [](const hd::Statistics& self) { return self.foreign.load(); },
            [](hd::Statistics& self, std::int64_t count) { self.foreign.store(count); })
        .def("summary", &summary)
        .def("answers_after", &answers_after);
    py::class_<hd::Outbox>(m, "Outbox")
        .def("switch", [](hd::Outbox& self, bool on) { self.on.store(on); })
        .def("send",
             [](hd::Outbox& self, std::int64_t stamp_ns) {
                 const py::gil_scoped_release released;
                 self.send(stamp_ns);
             })
        .def("publish", [](hd::Outbox& self, const std::string& data) { self.publish(data); });
    py::class_<ProgramFace>(m, "Program")
        .def("copy", &ProgramFace::copy)
        .def("step", &ProgramFace::step)
        .def("send", &ProgramFace::send)
        .def("announce", &ProgramFace::announce)
        .def("clear", &ProgramFace::clear);
    py::class_<LoopFace>(m, "Loop")
        .def("run", &LoopFace::run)
        .def("close", &LoopFace::close)
        .def("interrupt", [](LoopFace& self) { self.loop().interrupt(); })
        .def("rearm", [](LoopFace& self) { self.loop().rearm(); })
        .def("outbox", &LoopFace::outbox, py::arg("handle"), py::arg("template"), py::arg("stamp_at"), py::arg("runs"),
             py::return_value_policy::reference_internal)
        .def_property_readonly("real_time", &LoopFace::real_time)
        .def_property_readonly("polled", [](LoopFace& self) { return self.loop().polled(); })
        .def_property_readonly(
            "statistics", [](LoopFace& self) -> hd::Statistics& { return self.loop().statistics; },
            py::return_value_policy::reference_internal);
}

void bind_joined(py::module_& m) {
    py::class_<JoinedFace, LoopFace>(m, "JoinedLoop")
        .def(py::init<std::int64_t, bool>(), py::arg("dt_ns"), py::arg("poll") = false)
        .def("add_input", &JoinedFace::add_input)
        .def("add_slow", &JoinedFace::add_slow)
        .def("substitute", &JoinedFace::substitute, py::arg("input"), py::arg("to"), py::arg("source"))
        .def("restart", [](JoinedFace& self) { self.quietly([&] { self.get().restart(); }); })
        .def("dropped", [](JoinedFace& self, std::size_t input) { return self.get().dropped(input); })
        .def("seen", [](JoinedFace& self, std::size_t input) { return self.get().seen(input); })
        .def("set_active",
             [](JoinedFace& self, bool active) {
                 self.quietly([&] { self.get().between([&] { self.get().active.store(active); }); });
             })
        .def_property_readonly("active", [](JoinedFace& self) { return self.get().active.load(); })
        .def_property_readonly("tick", [](JoinedFace& self) { return self.get().tick(); })
        .def_property_readonly(
            "program", [](JoinedFace& self) -> ProgramFace& { return self.program; },
            py::return_value_policy::reference_internal)
        .def_property_readonly(
            "again", [](JoinedFace& self) -> ProgramFace& { return self.again; },
            py::return_value_policy::reference_internal);
}

py::tuple fault_of(TimedFace& self) {
    const hd::TimedFault& fault = self.get().fault;
    return py::make_tuple(fault.kind.load(), fault.tick.load(), fault.limit_ns.load(), fault.missing.load(),
                          fault.recorded.load());
}

void bind_timed(py::module_& m) {
    m.attr("NO_COMMAND") = static_cast<int>(hd::TimedFault::kNoCommand);
    m.attr("RECORDER_BEHIND") = static_cast<int>(hd::TimedFault::kRecorderBehind);
    py::class_<TimedFace, LoopFace>(m, "TimedLoop")
        .def(py::init<std::int64_t, bool, std::int64_t, std::int64_t, int, const py::object&>(), py::arg("dt_ns"),
             py::arg("lockstep"), py::arg("recorder_lag"), py::arg("temperature_ticks"), py::arg("joints"),
             py::arg("commands"))
        .def("listen", &TimedFace::listen, py::arg("handle"), py::arg("joint_names"))
        .def("follow_recorder", &TimedFace::follow_recorder)
        .def("report_progress", [](TimedFace& self, hd::Outbox& outbox) { self.get().report_progress(outbox); })
        .def("set_steps", &TimedFace::set_steps, py::arg("measure"), py::arg("advance"))
        .def("offer", &TimedFace::offer)
        .def("start", [](TimedFace& self) { self.quietly([&] { self.get().start(); }); })
        .def("stop", [](TimedFace& self) { self.quietly([&] { self.get().stop(); }); })
        .def("release", [](TimedFace& self) { self.quietly([&] { self.get().release(); }); })
        .def("set_values",
             [](TimedFace& self, std::int64_t pause_at, std::int64_t stop_after, std::int64_t timeout_ns) {
                 hd::TimedValues& values = self.get().values;
                 values.pause_at.store(pause_at), values.stop_after.store(stop_after);
                 values.timeout_ns.store(timeout_ns);
                 self.get().bell.ring();
             })
        .def("pretend_clock",
             [](TimedFace& self, std::int64_t steady_ns, std::int64_t system_offset_ns) {
                 hd::Clock& clock = self.get().clock;
                 clock.steady.store(steady_ns), clock.system.store(system_offset_ns), clock.pretended.store(true);
             })
        .def_property_readonly("steady_ns", [](TimedFace& self) { return self.get().clock.steady_now(); })
        .def_property_readonly("active", [](TimedFace& self) { return self.get().active.load(); })
        .def_property_readonly("tick", [](TimedFace& self) { return self.get().tick(); })
        .def_property_readonly("late", [](TimedFace& self) { return self.get().late(); })
        .def_property_readonly("unreadable", &TimedFace::unreadable)
        .def_property_readonly("skipped", [](TimedFace& self) { return self.get().skipped(); })
        .def_property_readonly("fault", &fault_of)
        .def_property_readonly(
            "send", [](TimedFace& self) -> ProgramFace& { return self.send; },
            py::return_value_policy::reference_internal)
        .def_property_readonly(
            "temperature", [](TimedFace& self) -> ProgramFace& { return self.temperature; },
            py::return_value_policy::reference_internal);
}

}  // namespace

PYBIND11_MODULE(_plane, m) {
    m.doc() = "Loops that take, join, step and publish without the interpreter.";
    bind_messages(m);
    bind_commands(m);
    bind_parts(m);
    bind_joined(m);
    bind_timed(m);
}
