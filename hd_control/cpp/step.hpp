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

// Where a loop leaves the commands that arrive, newest first served; given as a capsule named "hd.commands".
struct Commands {
    void* context = nullptr;
    // Torque [N m] of one tick for `count` joints; false if it is not newer than what is there, or ahead of time.
    bool (*offer)(void* context, const int* joints, int count, const double* torque, std::int64_t tick) = nullptr;
    std::int64_t (*tick_of)(void* context, int joint) = nullptr;  // of the command held; -1: never one
    bool (*stands)(void* context) = nullptr;                      // may another publisher take over now?
    void (*stranger)(void* context) = nullptr;                    // a command of another publisher was seen
};

constexpr const char* kCommandsCapsule = "hd.commands";

// A number that a loop looks at after its tick, such as the mode of a law; given as a capsule named "hd.reading".
struct Reading {
    void* context = nullptr;
    std::int64_t (*read)(void* context) = nullptr;
};

constexpr const char* kReadingCapsule = "hd.reading";

}  // namespace hd
