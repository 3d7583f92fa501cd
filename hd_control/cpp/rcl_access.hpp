// Subscriptions and publishers of rclpy, used from C++ by address and without the interpreter.
//
// rclpy gives the address of the rcl entity behind its own: `subscription.handle.pointer`. The few functions needed are
// looked up in the librcl that rclpy has loaded, so nothing is linked and one build serves the wheels and a sourced
// ROS. The only structure that crosses is the serialised message, stated here; where the headers of rcl are on the
// include path the compiler compares the two, and `calls` compares at run time.
#pragma once

#include <dlfcn.h>

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <new>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>

#if __has_include(<rcl/subscription.h>) && __has_include(<rcl/publisher.h>)
#include <rcl/publisher.h>
#include <rcl/subscription.h>
#define HD_RCL_HEADERS 1
#endif

namespace hd::rcl {

struct Allocator {  // rcutils_allocator_t
    void* (*allocate)(std::size_t, void*);
    void (*deallocate)(void*, void*);
    void* (*reallocate)(void*, std::size_t, void*);
    void* (*zero_allocate)(std::size_t, std::size_t, void*);
    void* state;
};

struct Serialized {  // rcl_serialized_message_t
    std::uint8_t* buffer;
    std::size_t length, capacity;
    Allocator allocator;
};

struct MessageInfo {  // rmw_message_info_t
    std::int64_t sent_ns, received_ns;
    std::uint64_t number;  // the how-manieth of its publisher, or kNoNumber
    std::uint64_t reception_number;
    const char* middleware;
    std::uint8_t publisher[16];
    bool from_this_process;
};
constexpr std::uint64_t kNoNumber = UINT64_MAX;  // RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED

constexpr int kOk = 0, kNothingThere = 401;  // RCL_RET_OK, RCL_RET_SUBSCRIPTION_TAKE_FAILED

#ifdef HD_RCL_HEADERS
static_assert(sizeof(Serialized) == sizeof(rcl_serialized_message_t));
static_assert(sizeof(Allocator) == sizeof(rcutils_allocator_t));
static_assert(offsetof(Serialized, length) == offsetof(rcl_serialized_message_t, buffer_length));
static_assert(offsetof(Serialized, capacity) == offsetof(rcl_serialized_message_t, buffer_capacity));
static_assert(offsetof(Serialized, allocator) == offsetof(rcl_serialized_message_t, allocator));
static_assert(offsetof(Allocator, state) == offsetof(rcutils_allocator_t, state));
static_assert(sizeof(MessageInfo) == sizeof(rmw_message_info_t));
static_assert(offsetof(MessageInfo, number) == offsetof(rmw_message_info_t, publication_sequence_number));
static_assert(offsetof(MessageInfo, publisher) ==
              offsetof(rmw_message_info_t, publisher_gid) + offsetof(rmw_gid_t, data));
static_assert(sizeof(MessageInfo::publisher) == RMW_GID_STORAGE_SIZE);
static_assert(kNoNumber == RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED);
static_assert(kOk == RCL_RET_OK && kNothingThere == RCL_RET_SUBSCRIPTION_TAKE_FAILED);
static_assert(std::is_same_v<rcl_event_callback_t, void (*)(const void*, std::size_t)>);
#endif

using Arrived = void (*)(const void* owner, std::size_t messages);

struct Calls {
    int (*take)(const void* subscription, Serialized*, void* info, void* allocation) = nullptr;
    int (*publish)(const void* publisher, const Serialized*, void* allocation) = nullptr;
    int (*on_new_message)(const void* subscription, Arrived, const void* owner) = nullptr;
    int (*make_array)(Serialized*, std::size_t, const Allocator*) = nullptr;
    void (*reset_error)() = nullptr;
    const char* (*middleware)() = nullptr;
};

inline Allocator plain_allocator() {
    return {[](std::size_t size, void*) { return std::malloc(size); }, [](void* pointer, void*) { std::free(pointer); },
            [](void* pointer, std::size_t size, void*) { return std::realloc(pointer, size); },
            [](std::size_t count, std::size_t size, void*) { return std::calloc(count, size); }, nullptr};
}

namespace detail {

template <typename Function>
void find(void* library, const char* name, Function& function) {
    function = reinterpret_cast<Function>(dlsym(library, name));
    if (function == nullptr) throw std::runtime_error(std::string("the loaded ROS 2 has no ") + name);
}

inline void compare_layout(const Calls& calls) {
    Serialized probe{};
    const Allocator own = plain_allocator();
    const bool same = calls.make_array(&probe, 1000, &own) == kOk && probe.buffer != nullptr && probe.length == 0 &&
                      probe.capacity == 1000 && std::memcmp(&probe.allocator, &own, sizeof own) == 0;
    if (!same) throw std::runtime_error("the serialised message of the loaded ROS 2 has another layout than Jazzy's");
    std::free(probe.buffer);
}

inline Calls load() {
    void* library = dlopen("librcl.so", RTLD_LAZY | RTLD_NOLOAD);
    if (library == nullptr) throw std::runtime_error("librcl is not loaded; import rclpy first");
    Calls calls;
    find(library, "rcl_take_serialized_message", calls.take);
    find(library, "rcl_publish_serialized_message", calls.publish);
    find(library, "rcl_subscription_set_on_new_message_callback", calls.on_new_message);
    find(library, "rcutils_uint8_array_init", calls.make_array);
    find(library, "rcutils_reset_error", calls.reset_error);
    find(library, "rmw_get_implementation_identifier", calls.middleware);
    compare_layout(calls);
    return calls;
}

}  // namespace detail

// The functions, looked up once. Throws std::runtime_error with the reason when they cannot be used.
inline const Calls& calls() {
    static const Calls found = detail::load();
    return found;
}

// Memory for one message, kept from take to take: it grows for a larger message and never shrinks.
class Buffer {
  public:
    explicit Buffer(std::size_t capacity) {
        message_.buffer = static_cast<std::uint8_t*>(std::malloc(capacity));
        if (message_.buffer == nullptr) throw std::bad_alloc();
        message_.capacity = capacity;
        message_.allocator = plain_allocator();
    }
    Buffer(Buffer&& other) noexcept : message_(other.message_) { other.message_.buffer = nullptr; }
    Buffer(const Buffer&) = delete;
    Buffer& operator=(const Buffer&) = delete;
    Buffer& operator=(Buffer&&) = delete;
    ~Buffer() { std::free(message_.buffer); }

    Serialized* get() { return &message_; }
    std::string_view view() const { return {reinterpret_cast<const char*>(message_.buffer), message_.length}; }

  private:
    Serialized message_{};
};

// The oldest message that waits, in `buffer`; false if there is none or the subscription is not usable.
inline bool take(const Calls& calls, const void* subscription, Buffer& buffer, MessageInfo* info = nullptr) {
    const int outcome = calls.take(subscription, buffer.get(), info, nullptr);
    if (outcome == kOk) return true;
    if (outcome != kNothingThere) calls.reset_error();
    return false;
}

// Publishes the bytes as they are; false if the publisher is not usable.
inline bool publish(const Calls& calls, const void* publisher, const std::string& bytes) {
    Serialized message{};
    message.buffer = reinterpret_cast<std::uint8_t*>(const_cast<char*>(bytes.data()));
    message.length = message.capacity = bytes.size();
    message.allocator = plain_allocator();
    if (calls.publish(publisher, &message, nullptr) == kOk) return true;
    calls.reset_error();
    return false;
}

// Can new-message callbacks be set and removed while messages arrive? Locks, as read in the sources of rmw_fastrtps 8.4
// and Fast DDS 2.14: the receiving thread holds the reader's, then the listener's (let go at once), then the
// callback's; setting takes the reader's and lets it go, then the callback's, then the listener's; removing the
// callback's, then the listener's; a take the reader's alone. So there is no cycle as long as the callback takes no
// lock. After removing no callback runs: it would hold the callback's lock. Setting may miss a message that arrives in
// the middle: look once afterwards. Other middlewares were not read.
inline bool callbacks_are_safe(const Calls& calls) {
    return std::string_view(calls.middleware()) == "rmw_fastrtps_cpp";
}

}  // namespace hd::rcl
