// Python module hd_control._pump: the recorder's counts, queues, growing file and threads. See pump.hpp.
//
// Whoever waits for the lock of a file has let go of the interpreter: the holder may need it for a file that is a
// Python object. Queues and counts are locked for moments by threads that never need the interpreter.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>
#include <unistd.h>

#include <system_error>

#include "pump.hpp"

namespace py = pybind11;

namespace {

using Free = py::gil_scoped_release;

// Held by Python, destroyed without the interpreter: a thread that is waited for may need it for its last word.
template <class Value>
struct DestroyedFree {
    void operator()(Value* value) const {
        const Free free;
        delete value;
    }
};
template <class Value>
using Unheld = std::unique_ptr<Value, DestroyedFree<Value>>;

using Stamps = py::array_t<std::int64_t, py::array::c_style | py::array::forcecast>;

// Contiguous bytes of any object, for as long as this lives.
class Bytes {
  public:
    explicit Bytes(const py::buffer& object) {
        if (PyObject_GetBuffer(object.ptr(), &view_, PyBUF_SIMPLE) != 0) throw py::error_already_set();
    }
    Bytes(const Bytes&) = delete;
    Bytes& operator=(const Bytes&) = delete;
    ~Bytes() { PyBuffer_Release(&view_); }
    std::string_view get() const { return {static_cast<const char*>(view_.buf), static_cast<std::size_t>(view_.len)}; }

  private:
    Py_buffer view_{};
};

// ---------------------------------------------------------------------------------------------------------------------
// Where the bytes of a file go: to a file descriptor, or to an object with `write`.

hd::Sink descriptor_sink(int descriptor) {
    return [descriptor](std::string_view bytes) {
        ssize_t count = -1;
        do {
            count = ::write(descriptor, bytes.data(), bytes.size());
        } while (count < 0 && errno == EINTR);
        if (count < 0) throw hd::WriteFailure(errno, std::generic_category().message(errno));
        return static_cast<std::size_t>(count);
    };
}

hd::Sink object_sink(const py::object& stream) {
    const auto release = [](py::object* object) {
        const py::gil_scoped_acquire held;
        delete object;
    };
    const std::shared_ptr<py::object> kept(new py::object(stream), release);
    return [kept](std::string_view bytes) {
        const py::gil_scoped_acquire held;
        try {
            const py::object count =
                kept->attr("write")(py::memoryview::from_memory(bytes.data(), static_cast<py::ssize_t>(bytes.size())));
            return count.is_none() ? std::size_t{0} : count.cast<std::size_t>();
        } catch (py::error_already_set& error) {
            if (!error.matches(PyExc_OSError) || error.value().attr("errno").is_none()) throw;
            const auto code = error.value().attr("errno").cast<int>();
            throw hd::WriteFailure(code, py::str(error.value().attr("strerror")).cast<std::string>());
        }
    };
}

hd::Sink sink_of(const py::object& target) {
    return py::isinstance<py::int_>(target) ? descriptor_sink(target.cast<int>()) : object_sink(target);
}

void raise_os_error(const hd::WriteFailure& failure) {
    PyErr_SetObject(PyExc_OSError, py::make_tuple(failure.code, failure.what()).ptr());
}

// ---------------------------------------------------------------------------------------------------------------------

py::dict as_dict(const hd::Counts& counts) {
    py::dict drops;
    drops["transport"] = counts.drops.transport;
    drops["queue"] = counts.drops.queue;
    drops["disk"] = counts.drops.disk;
    drops["size"] = counts.drops.size;
    py::dict table;
    table["received"] = counts.received;
    table["written"] = counts.written;
    table["gaps"] = counts.gaps;
    table["missing"] = counts.missing;
    table["never_published"] = counts.never_published;
    table["duplicates"] = counts.duplicates;
    table["out_of_order"] = counts.out_of_order;
    table["drops"] = drops;
    return table;
}

py::tuple head_of(hd::Head head, const py::buffer& payload) {
    const Bytes bytes(payload);
    const hd::StampAndFrame found = hd::stamp_and_frame(head, bytes.get());
    py::object stamp = py::none();
    if (found.stamped) stamp = py::int_(found.stamp_ns);
    return py::make_tuple(stamp, py::bytes(found.frame.data(), found.frame.size()));
}

void see(hd::Account& account, std::optional<std::int64_t> stamp_ns, std::string_view frame) {
    account.see({stamp_ns.has_value(), stamp_ns.value_or(0), frame}, {}, false);
}

void see_many(hd::Account& account, const Stamps& stamps, std::string_view frame) {
    const std::int64_t* stamp = stamps.data();
    for (py::ssize_t i = 0; i < stamps.size(); ++i) account.see({true, stamp[i], frame}, {}, false);
}

std::vector<py::bytes> frames(const hd::Account& account) {
    std::vector<py::bytes> found;
    for (const std::string& frame : account.frames()) found.emplace_back(frame);
    return found;
}

// ---------------------------------------------------------------------------------------------------------------------

// A value of the file, read under its lock.
template <class Value>
auto locked(Value (hd::RecordFile::*read)() const) {
    return [read](hd::RecordFile& file) -> std::decay_t<Value> {
        const Free free;
        const std::lock_guard<std::mutex> lock(file.mutex);
        return (file.*read)();
    };
}

void set_sink(hd::RecordFile& file, const py::object& target) {
    hd::Sink sink = sink_of(target);
    const Free free;
    const std::lock_guard<std::mutex> lock(file.mutex);
    std::swap(file.sink, sink);
}

std::uint64_t append(hd::RecordFile& file, const py::buffer& data) {
    const Bytes bytes(data);
    const Free free;
    const std::lock_guard<std::mutex> lock(file.mutex);
    return file.append(bytes.get());
}

void message(hd::RecordFile& file, std::uint16_t channel, std::uint32_t sequence, std::int64_t log_ns,
             std::int64_t publish_ns, const py::buffer& payload) {
    const Bytes bytes(payload);
    const Free free;
    const std::lock_guard<std::mutex> lock(file.mutex);
    file.message(channel, sequence, log_ns, publish_ns, bytes.get());
}

void count(hd::RecordFile& file, std::uint16_t channel, std::int64_t number, std::int64_t first, std::int64_t last) {
    const Free free;
    const std::lock_guard<std::mutex> lock(file.mutex);
    file.count(channel, number, first, last);
}

void flush(hd::RecordFile& file) {
    const Free free;
    const std::lock_guard<std::mutex> lock(file.mutex);
    file.flush();
}

// ---------------------------------------------------------------------------------------------------------------------

std::size_t add_topic(hd::SampleQueues& queues, std::uint16_t channel, hd::Head head, std::size_t depth, bool event,
                      bool awaited, bool paced, std::shared_ptr<hd::Account> account) {
    return queues.add({channel, head, depth, event, awaited, paced, std::move(account)});
}

void offer(hd::SampleQueues& queues, std::size_t topic, std::int64_t log_ns, const py::buffer& payload,
           std::optional<std::uint64_t> number, std::string_view publisher) {
    const Bytes bytes(payload);
    hd::Origin origin{number.has_value(), {}, number.value_or(0)};
    std::copy_n(publisher.begin(), std::min(publisher.size(), origin.publisher.size()), origin.publisher.begin());
    queues.offer(topic, log_ns, bytes.get(), origin);
}

std::size_t drain(hd::SampleQueues& queues, hd::RecordFile& file, std::size_t limit) {
    const Free free;
    return queues.drain(file, limit);
}

py::list table(const hd::SampleQueues& queues) {
    py::list rows;
    for (const auto& [counts, queued] : queues.table()) {
        py::dict row = as_dict(counts);
        row["queued"] = queued;
        rows.append(row);
    }
    return rows;
}

py::object failure(const hd::Writer& writer) {
    const auto found = writer.failure();
    return found ? py::object(py::make_tuple(found->code, found->what())) : py::object(py::none());
}

// ---------------------------------------------------------------------------------------------------------------------

// A pump that keeps what it uses. rclpy frees the entity behind a handle with the last reference, or with `destroy`
// once nobody is inside it; this holds both until the taking thread has ended. So the entities outlive the thread in
// whatever order a node, its context and its subscriptions end, also where the garbage collector takes all of them at
// once.
class KeptPump {
  public:
    explicit KeptPump(std::int64_t dt_ns) : pump_(dt_ns) {}
    KeptPump(const KeptPump&) = delete;
    KeptPump& operator=(const KeptPump&) = delete;
    ~KeptPump() { end(); }

    void add(const py::object& handle, bool paced) {
        const void* subscription = entity(handle);
        const Free free;
        pump_.add(subscription, paced);
    }
    void report_to(const py::object& handle) {
        const void* publisher = entity(handle);
        const Free free;
        pump_.report_to(publisher);
    }
    void start(bool rest, int priority) {
        const Free free;
        pump_.start(rest, priority);
    }
    void record(std::shared_ptr<hd::SampleQueues> queues) {
        const Free free;
        pump_.record(std::move(queues));
    }
    std::int64_t taken() const { return pump_.taken(); }

    // From any thread, as often as one likes; when it returns the thread has ended.
    void end() {
        {
            const Free free;
            pump_.end();
        }
        std::vector<py::object> used;
        used.swap(used_);
        for (const py::object& handle : used) leave(handle);
    }

  private:
    const void* entity(const py::object& handle) {
        handle.attr("__enter__")();
        used_.push_back(handle);
        return reinterpret_cast<const void*>(handle.attr("pointer").cast<std::uintptr_t>());
    }
    static void leave(const py::object& handle) {
        try {
            handle.attr("__exit__")(py::none(), py::none(), py::none());
        } catch (py::error_already_set& error) {
            error.discard_as_unraisable("hd_control._pump");
        }
    }
    hd::Pump pump_;
    std::vector<py::object> used_;
};

// Threads of this module that run. At the end of the interpreter, while everything is still there, they are ended.
void add_running(const py::object& self) { py::module_::import("hd_control._pump").attr("_running").attr("add")(self); }

void end_running(const py::object& running) {
    for (const py::handle each : py::list(running)) each.attr("end")();
}

void bind_counts(py::module_& module) {
    py::enum_<hd::Head>(module, "Head")
        .value("NONE", hd::Head::none)
        .value("HEADER", hd::Head::header)
        .value("CLOCK", hd::Head::clock);
    module.def("head_of", &head_of, py::arg("head"), py::arg("payload"), "(stamp_ns or None, frame_id) of a message.");
    py::class_<hd::Account, std::shared_ptr<hd::Account>>(module, "Account")
        .def(py::init<std::int64_t>(), py::arg("period_ns"))
        .def_readonly("period_ns", &hd::Account::period_ns)
        .def("see", &see, py::arg("stamp_ns"), py::arg("frame_id") = "")
        .def("see_many", &see_many, py::arg("stamps_ns"), py::arg("frame_id") = "")
        .def("wrote", &hd::Account::wrote)
        .def("lost_on_disk", &hd::Account::lost_on_disk)
        .def("counts", [](const hd::Account& account) { return as_dict(account.counts()); })
        .def_property_readonly("written", [](const hd::Account& account) { return account.counts().written; })
        .def("frames", &frames);
}

void bind_file(py::module_& module) {
    py::class_<hd::RecordFile, std::shared_ptr<hd::RecordFile>>(module, "RecordFile")
        .def(py::init([](const py::object& target) { return std::make_shared<hd::RecordFile>(sink_of(target)); }))
        .def("set_sink", &set_sink)
        .def("append", &append)
        .def("message", &message)
        .def("count", &count)
        .def("flush", &flush)
        .def_property_readonly("position", locked(&hd::RecordFile::position))
        .def_property_readonly("end", locked(&hd::RecordFile::end))
        .def_property_readonly("pending", locked(&hd::RecordFile::pending))
        .def_property_readonly("crc", locked(&hd::RecordFile::crc))
        .def_property_readonly("counts", locked(&hd::RecordFile::counts))
        .def_property_readonly("first_ns", locked(&hd::RecordFile::first_ns))
        .def_property_readonly("last_ns", locked(&hd::RecordFile::last_ns));
}

void bind_queues(py::module_& module) {
    py::class_<hd::SampleQueues, std::shared_ptr<hd::SampleQueues>>(module, "SampleQueues")
        .def(py::init([](std::size_t samples, std::size_t bytes, std::size_t record) {
                 return std::make_shared<hd::SampleQueues>(hd::QueueLimits{samples, bytes, record});
             }),
             py::arg("samples"), py::arg("bytes"), py::arg("record"))
        .def("add", &add_topic, py::arg("channel"), py::arg("head"), py::arg("depth"), py::arg("event"),
             py::arg("awaited"), py::arg("paced"), py::arg("account"))
        .def("offer", &offer, py::arg("topic"), py::arg("log_ns"), py::arg("payload"), py::arg("number") = py::none(),
             py::arg("publisher") = "")
        .def("drain", &drain, py::arg("file"), py::arg("limit"))
        .def("fail", &hd::SampleQueues::fail)
        .def("table", &table)
        .def("slowest_ns", &hd::SampleQueues::slowest_ns);
}

void bind_threads(py::module_& module) {
    py::class_<hd::Writer, Unheld<hd::Writer>>(module, "Writer")
        .def(py::init<std::shared_ptr<hd::SampleQueues>, std::shared_ptr<hd::RecordFile>>())
        .def("start",
             [](const py::object& self) {
                 self.cast<hd::Writer&>().start();
                 add_running(self);
             })
        .def("end", &hd::Writer::end, py::call_guard<Free>())
        .def_property_readonly("failure", &failure);
    py::class_<KeptPump>(module, "Pump")
        .def(py::init<std::int64_t>(), py::arg("dt_ns"))
        .def("add", &KeptPump::add, py::arg("subscription"), py::arg("paced"))
        .def("report_to", &KeptPump::report_to, py::arg("publisher"))
        .def(
            "start",
            [](const py::object& self, bool rest, int priority) {
                self.cast<KeptPump&>().start(rest, priority);
                add_running(self);
            },
            py::arg("rest"), py::arg("priority"))
        .def("end", &KeptPump::end)
        .def("record", &KeptPump::record, py::arg("queues").none(true))
        .def_property_readonly("taken", &KeptPump::taken);
    const py::object running = py::module_::import("weakref").attr("WeakSet")();
    module.attr("_running") = running;
    py::module_::import("atexit").attr("register")(py::cpp_function(&end_running), running);
}

}  // namespace

PYBIND11_MODULE(_pump, module) {
    module.doc() = "The recorder beside the interpreter: counts, bounded queues, a growing MCAP file, two threads.";
    py::register_exception_translator([](std::exception_ptr thrown) {
        try {
            if (thrown) std::rethrow_exception(thrown);
        } catch (const hd::WriteFailure& failure) {
            raise_os_error(failure);
        }
    });
    bind_counts(module);
    bind_file(module);
    bind_queues(module);
    bind_threads(module);
}
