// Python module hd_control._records: finds messages in MCAP bytes and takes fixed fields out of many of them.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include "mcap_scan.hpp"

namespace py = pybind11;

namespace {

struct Bytes {
    py::buffer_info info;
    const std::uint8_t* data;
    std::size_t size;
    explicit Bytes(const py::buffer& buffer)
        : info(buffer.request()),
          data(static_cast<const std::uint8_t*>(info.ptr)),
          size(static_cast<std::size_t>(info.size) * static_cast<std::size_t>(info.itemsize)) {
        if (info.ndim != 1 || (info.size > 0 && info.strides[0] != info.itemsize))
            throw py::value_error("expected contiguous bytes");
    }
};

template <class Number>
py::array_t<Number> array_of(const std::vector<Number>& values) {
    return py::array_t<Number>(static_cast<py::ssize_t>(values.size()), values.data());
}

py::dict scan(const py::buffer& buffer, std::size_t start, std::uint64_t record_cap, std::size_t max_messages) {
    const Bytes bytes(buffer);
    hd::McapScan found;
    {
        py::gil_scoped_release release;
        found = hd::scan_records(bytes.data, bytes.size, start, record_cap, max_messages);
    }
    py::dict result;
    result["channel"] = array_of(found.channel);
    result["sequence"] = array_of(found.sequence);
    result["log_time"] = array_of(found.log_time);
    result["publish_time"] = array_of(found.publish_time);
    result["offset"] = array_of(found.offset);
    result["length"] = array_of(found.length);
    result["other_opcode"] = array_of(found.other_opcode);
    result["other_offset"] = array_of(found.other_offset);
    result["other_length"] = array_of(found.other_length);
    result["stop"] = found.stop;
    result["reason"] = found.reason;
    result["footer"] = found.footer;
    result["limit"] = found.limit;
    return result;
}

using Offsets = py::array_t<std::int64_t, py::array::c_style | py::array::forcecast>;

py::array_t<bool> match(const py::buffer& buffer, const Offsets& offsets, const Offsets& lengths,
                        const py::bytes& fixed, const py::bytes& mask, std::int64_t surplus) {
    const Bytes bytes(buffer);
    const std::string fixed_text = fixed, mask_text = mask;
    if (offsets.size() != lengths.size() || fixed_text.size() != mask_text.size())
        throw py::value_error("offsets and lengths, or fixed and mask, differ in size");
    py::array_t<bool> result(offsets.size());
    bool* out = result.mutable_data();
    for (py::ssize_t i = 0; i < offsets.size(); ++i) {
        const std::int64_t at = offsets.data()[i], length = lengths.data()[i];
        out[i] = hd::inside(at, length, bytes.size) &&
                 hd::has_layout(bytes.data + at, length, reinterpret_cast<const std::uint8_t*>(fixed_text.data()),
                                reinterpret_cast<const std::uint8_t*>(mask_text.data()),
                                static_cast<std::int64_t>(fixed_text.size()), surplus);
    }
    return result;
}

py::array_t<std::uint8_t> take(const py::buffer& buffer, const Offsets& offsets, std::int64_t at, std::int64_t width) {
    const Bytes bytes(buffer);
    if (at < 0 || width < 0) throw py::value_error("negative place or width");
    py::array_t<std::uint8_t> result({offsets.size(), static_cast<py::ssize_t>(width)});
    std::uint8_t* out = result.mutable_data();
    for (py::ssize_t i = 0; i < offsets.size(); ++i, out += width) {
        const std::int64_t offset = offsets.data()[i];
        if (offset < 0 || offset > INT64_MAX - at || !hd::inside(offset + at, width, bytes.size))
            throw py::index_error("field outside the buffer");
        std::memcpy(out, bytes.data + offset + at, static_cast<std::size_t>(width));
    }
    return result;
}

}  // namespace

PYBIND11_MODULE(_records, module) {
    module.doc() =
        "Finds messages in MCAP bytes and takes fixed fields out of many of them; never reads outside the buffer.";
    module.def(
        "scan", &scan, py::arg("buffer"), py::arg("start"), py::arg("record_cap"), py::arg("max_messages"),
        "Records from byte `start` on: arrays of the messages and of the other records, and where and why it stopped.");
    module.def("match", &match, py::arg("buffer"), py::arg("offsets"), py::arg("lengths"), py::arg("fixed"),
               py::arg("mask"), py::arg("surplus"), "(n,) True where the payload has the fixed bytes of a layout.");
    module.def("take", &take, py::arg("buffer"), py::arg("offsets"), py::arg("at"), py::arg("width"),
               "(n, width) bytes at `at` within each payload. Raises IndexError rather than read outside the buffer.");
}
