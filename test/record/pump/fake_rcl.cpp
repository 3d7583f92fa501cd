// A stand-in for librcl: a subscription has a lock as a reader of the middleware has it, and whoever delivers a message
// calls the new-message callback inside that lock.
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <mutex>
#include <string>

#include "rcl_access.hpp"

#define EXPORTED extern "C" __attribute__((visibility("default")))

struct Subscription {
    std::recursive_mutex reader;
    std::mutex callback;
    std::deque<std::string> queue;
    hd::rcl::Arrived arrived = nullptr;
    const void* owner = nullptr;
    std::uint64_t taken = 0;
};
using Lock = std::lock_guard<std::mutex>;
using ReaderLock = std::lock_guard<std::recursive_mutex>;

static Subscription& opened(const void* subscription) {
    return *const_cast<Subscription*>(static_cast<const Subscription*>(subscription));
}

EXPORTED int rcl_take_serialized_message(const void* from, hd::rcl::Serialized* out, void* info, void*) {
    Subscription& subscription = opened(from);
    const ReaderLock lock(subscription.reader);
    if (subscription.queue.empty()) return hd::rcl::kNothingThere;
    const std::string& message = subscription.queue.front();
    if (out->capacity < message.size()) {
        out->buffer = static_cast<std::uint8_t*>(std::realloc(out->buffer, message.size()));
        out->capacity = message.size();
    }
    std::memcpy(out->buffer, message.data(), message.size());
    out->length = message.size();
    hd::rcl::MessageInfo found{};
    found.number = ++subscription.taken;
    *static_cast<hd::rcl::MessageInfo*>(info) = found;
    subscription.queue.pop_front();
    return hd::rcl::kOk;
}
EXPORTED int rcl_publish_serialized_message(const void*, const hd::rcl::Serialized*, void*) { return hd::rcl::kOk; }
EXPORTED int rcl_subscription_set_on_new_message_callback(const void* to, hd::rcl::Arrived arrived, const void* owner) {
    Subscription& subscription = opened(to);
    if (arrived != nullptr) {
        const ReaderLock lock(subscription.reader);
    }
    const Lock lock(subscription.callback);
    subscription.arrived = arrived;
    subscription.owner = owner;
    return hd::rcl::kOk;
}
EXPORTED int rcutils_uint8_array_init(hd::rcl::Serialized* array, std::size_t size, const hd::rcl::Allocator* with) {
    *array = {static_cast<std::uint8_t*>(with->allocate(size, with->state)), 0, size, *with};
    return hd::rcl::kOk;
}
EXPORTED void rcutils_reset_error() {}
EXPORTED const char* rmw_get_implementation_identifier() { return "rmw_fastrtps_cpp"; }

EXPORTED Subscription* fake_make() { return new Subscription; }
EXPORTED void fake_free(Subscription* subscription) { delete subscription; }
EXPORTED void fake_deliver(Subscription* to, const char* bytes, std::size_t size) {
    const ReaderLock lock(to->reader);
    if (to->queue.size() < 50) to->queue.emplace_back(bytes, size);
    const Lock called(to->callback);
    if (to->arrived != nullptr) to->arrived(to->owner, 1);
}
