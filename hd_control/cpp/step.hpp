// What a native loop runs once per tick: a function and its memory. Given to the loop as a capsule named "hd.step".
//
// `run` takes no lock, allocates nothing and never throws; what went wrong is in the memory that the owner reads.
#pragma once

#include <cstdint>

namespace hd {

struct Step {
    void* context = nullptr;
    void (*run)(void* context, std::int64_t tick) = nullptr;

    void operator()(std::int64_t tick) const { run(context, tick); }
};

constexpr const char* kStepCapsule = "hd.step";

}  // namespace hd
