// Steps, readings and commands on their way through Python: a capsule that keeps the owner of the memory alive.
#pragma once

#include <pybind11/pybind11.h>

#include <utility>

namespace hd {

// `value` in a capsule of that name. `owner` is the Python object whose memory the value points to.
template <typename Value>
pybind11::capsule owned_capsule(Value value, const char* name, pybind11::object owner) {
    struct Owned : Value {
        pybind11::object owner;
    };
    auto* owned = new Owned{std::move(value), std::move(owner)};
    return pybind11::capsule(static_cast<Value*>(owned), name,
                             [](void* pointer) { delete static_cast<Owned*>(static_cast<Value*>(pointer)); });
}

// The value in a capsule of that name. Throws pybind11::error_already_set for anything else.
template <typename Value>
Value& in_capsule(const pybind11::object& capsule, const char* name) {
    void* pointer = PyCapsule_GetPointer(capsule.ptr(), name);
    if (pointer == nullptr) throw pybind11::error_already_set();
    return *static_cast<Value*>(pointer);
}

}  // namespace hd
