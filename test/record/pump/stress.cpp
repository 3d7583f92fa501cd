// Pumps and writers are begun, looked at and ended in every order while messages arrive; the counts must balance.
// Arguments: path of the stand-in for librcl, how often. Exit code 1: a count is wrong.
#include <dlfcn.h>

#include <cstdio>
#include <cstdlib>

#include "pump.hpp"

struct Subscription;
using std::chrono::microseconds;
using std::chrono::milliseconds;

constexpr int kTopics = 4;
struct Fake {
    Subscription* (*make)();
    void (*free)(Subscription*);
    void (*deliver)(Subscription*, const char*, std::size_t);
};

template <class Function>
void find(void* library, const char* name, Function& function) {
    function = reinterpret_cast<Function>(dlsym(library, name));
}

void pause(milliseconds time) { std::this_thread::sleep_for(time); }

// Delivers ticks to all subscriptions until it is over.
void traffic(const Fake& fake, Subscription* const (&subscriptions)[kTopics], const std::atomic<bool>& over) {
    std::string message(64, 'a');
    std::memcpy(&message[12], "\x11\0\0\0", 4);  // the frame has 17 characters
    for (std::int32_t tick = 0; !over; ++tick) {
        std::memcpy(&message[4], &tick, sizeof tick);
        for (Subscription* each : subscriptions) fake.deliver(each, message.data(), message.size());
        if (tick % 16 == 0) std::this_thread::sleep_for(microseconds(200));
    }
}

// One recording. Every fifth has a full disk, every third ends in the middle by another thread or twice.
void record(int number, Subscription* const (&subscriptions)[kTopics],
            const std::shared_ptr<hd::SampleQueues>& queues) {
    const auto file = std::make_shared<hd::RecordFile>([number, calls = 0](std::string_view bytes) mutable {
        if (number % 5 == 4 && ++calls > 3) throw hd::WriteFailure(ENOSPC, "full");
        return bytes.size();
    });
    hd::Pump pump(1000000);
    for (Subscription* each : subscriptions) pump.add(each, true);
    hd::Writer writer(queues, file);
    pump.start(number % 2 == 1, 0);
    writer.start();
    pump.record(queues);
    pump.report_to(subscriptions);
    std::thread looking([&] {
        for (int i = 0; i < 20; ++i) {
            queues->table(), queues->slowest_ns(), pump.taken(), writer.failure();
            {
                const std::lock_guard<std::mutex> lock(file->mutex);
                file->append("metadata");
            }
            std::this_thread::sleep_for(microseconds(300));
        }
    });
    std::thread ending([&] {
        pause(milliseconds(3));
        if (number % 3 == 0) pump.end();
    });
    pause(milliseconds(5 + number % 7));
    if (number % 3 == 1) pump.record(nullptr);
    if (number % 3 == 2) pump.end();
    looking.join(), ending.join();
    pump.end();
    writer.end();
    if (writer.failure()) queues->fail();
}

bool balanced(const hd::SampleQueues& queues) {
    for (const auto& [counts, queued] : queues.table()) {
        const std::int64_t found = counts.written + counts.drops.queue + counts.drops.disk + std::int64_t(queued);
        if (counts.received != found) return false;
    }
    return true;
}

int main(int, char** arguments) {
    void* library = dlopen(arguments[1], RTLD_NOW | RTLD_GLOBAL);
    if (library == nullptr) return std::puts(dlerror()), 2;
    Fake fake{};
    find(library, "fake_make", fake.make), find(library, "fake_free", fake.free);
    find(library, "fake_deliver", fake.deliver);
    for (int number = 0; number < std::atoi(arguments[2]); ++number) {
        Subscription* subscriptions[kTopics];
        const auto queues = std::make_shared<hd::SampleQueues>(hd::QueueLimits{200, 1 << 20, 1 << 16});
        for (int topic = 0; topic < kTopics; ++topic) {
            subscriptions[topic] = fake.make();
            const auto account = std::make_shared<hd::Account>(1000000000);
            queues->add({std::uint16_t(topic), hd::Head::header, 50, false, topic < 2, true, account});
        }
        std::atomic<bool> over{false};
        std::thread publishing([&] { traffic(fake, subscriptions, over); });
        record(number, subscriptions, queues);
        over = true;
        publishing.join();
        for (Subscription* each : subscriptions) fake.free(each);
        if (!balanced(*queues)) return std::printf("recording %d is not in balance\n", number), 1;
    }
    return std::puts("balanced"), 0;
}
