// Named blocks of numbers: the memory that laws share with Python.
//
// A block is one contiguous run of doubles, divided into named fields. Each field holds `per_joint` numbers for every
// joint, or one number when `per_joint` is 0. A law declares its blocks once, as a list of fields:
//
//     #define HD_TORQUE_STATE(FIELD) FIELD(motor_velocity, 1, "rad/s", "filtered rotor velocity, output side")
//     HD_BLOCK(TorqueState, HD_TORQUE_STATE)
//
// C++ then reads `state.motor_velocity[joint]`; Python reads the same memory as `state.motor_velocity`, and the names,
// units and meanings of the list serve introspection topics, tables and the glossary.
//
// A field of a parameter block also says what is allowed, and becomes a parameter by that, with no second list:
//
//     FIELD(gear_ratio, 1, "-", "rotor turns per joint turn", above(0.0))
#pragma once

#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <string>
#include <vector>

namespace hd {

// What a field may hold: finite numbers between bounds, whole numbers, 0 or 1 for false or true, or the number of a
// word, counted from 0. And how far it may go while the law runs, from where it was when the law was activated: up to
// `live_factor` times as large or as small, and `live_share` of what the unit means at this joint (a torque: of the
// effort limit; hd_control/core/parameters.py, `live_scale`). 1 and 0: not at all.
struct Allowed {
    const char* kind = "number";
    double low = -INFINITY, high = INFINITY;
    bool open_low = false;   // `low` itself is not allowed
    const char* words = "";  // separated by spaces
    double live_factor = 1.0, live_share = 0.0;

    constexpr Allowed times(double factor) const { return {kind, low, high, open_low, words, factor, live_share}; }
    constexpr Allowed within(double share) const { return {kind, low, high, open_low, words, live_factor, share}; }
};

constexpr Allowed any() { return {}; }

constexpr Allowed above(double low, double high = INFINITY) { return {"number", low, high, true}; }
constexpr Allowed at_least(double low, double high = INFINITY) { return {"number", low, high}; }
constexpr Allowed between(double low, double high) { return {"number", low, high}; }
constexpr Allowed whole(double low, double high) { return {"whole", low, high}; }
constexpr Allowed truth() { return {"truth", 0.0, 1.0}; }
constexpr Allowed one_of(const char* words) { return {"word", 0.0, INFINITY, false, words}; }

struct Field {
    const char* name;
    int per_joint;
    const char* unit;
    const char* meaning;
    Allowed allowed = {};
};

inline std::size_t field_size(int per_joint, int joints) {
    return per_joint == 0 ? 1U : static_cast<std::size_t>(per_joint) * static_cast<std::size_t>(joints);
}

inline std::size_t block_size(const std::vector<Field>& fields, int joints) {
    std::size_t size = 0;
    for (const Field& field : fields) size += field_size(field.per_joint, joints);
    return size;
}

}  // namespace hd

#define HD_FIELD_POINTER(name, ...) double* name;
#define HD_FIELD_ASSIGN(name, per_joint, ...) \
    name = base;                              \
    base += hd::field_size(per_joint, joints);
#define HD_FIELD_ENTRY(name, ...) {#name, __VA_ARGS__},

#define HD_BLOCK(Block, FIELDS)                                                          \
    struct Block {                                                                       \
        static const char* block_name() { return #Block; }                               \
        FIELDS(HD_FIELD_POINTER)                                                         \
        Block(double* base, int joints) { FIELDS(HD_FIELD_ASSIGN) }                      \
        static const std::vector<hd::Field>& fields() {                                  \
            static const std::vector<hd::Field> list{FIELDS(HD_FIELD_ENTRY)};            \
            return list;                                                                 \
        }                                                                                \
        static std::size_t size(int joints) { return hd::block_size(fields(), joints); } \
    };
