// Thread pool: see threads.hpp. Workers spin for a short while between regions (a solver step is
// a few hundred microseconds, a futex wake-up tens) and sleep after that.
#include "core/threads.hpp"

#include <sched.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <cstdint>
#include <cstdlib>
#include <exception>
#include <fstream>
#include <mutex>
#include <string>
#include <system_error>
#include <thread>
#include <vector>

#include "core/error.hpp"

namespace tledface {
namespace {

// Long enough to bridge the gap between two steps, short enough not to burn a core while idle.
constexpr auto kSpinTime = std::chrono::microseconds(200);

thread_local bool inside_region = false;

std::atomic<std::size_t> thread_limit{SIZE_MAX};

void pause_cpu() {
#if defined(__x86_64__)
  __builtin_ia32_pause();
#endif
}

class Pool {
 public:
  // Fewer threads where the system gives no more (a limit of processes or of memory): those that
  // are there must not be left waiting for a pool that was never finished.
  explicit Pool(std::size_t n_threads) : shares_(n_threads) {
    workers_.reserve(n_threads);
    try {
      for (std::size_t i = 1; i < n_threads; ++i) workers_.emplace_back([this, i] { work(i); });
    } catch (const std::system_error&) {
    }
  }
  void run(std::size_t n_items, const std::function<void(std::size_t)>& body) {
    std::lock_guard<std::mutex> one_region_at_a_time(region_);
    body_ = &body;
    n_shares_ = std::min(workers_.size() + 1, std::max<std::size_t>(1, thread_limit.load()));
    for (std::size_t i = 0; i < n_shares_; ++i) {
      shares_[i].next.store(share_begin(n_items, i), std::memory_order_relaxed);
      shares_[i].end = share_begin(n_items, i + 1);
    }
    busy_.store(workers_.size(), std::memory_order_relaxed);
    error_ = nullptr;
    {
      std::lock_guard<std::mutex> lock(mutex_);
      generation_.fetch_add(1, std::memory_order_release);
    }
    if (sleepers_.load(std::memory_order_acquire) > 0) wake_.notify_all();
    take_items(0);
    // Counted no further than needed: the last item of a worker may take minutes.
    for (int spins = 0; busy_.load(std::memory_order_acquire) > 0;) {
      if (spins < 4096) {
        ++spins;
        pause_cpu();
      } else {
        std::this_thread::yield();
      }
    }
    if (error_) std::rethrow_exception(error_);
  }

 private:
  // What thread `number` of a region takes first, so that from region to region (the steps of a
  // solver) the same thread works on the same part, which its own cache still holds; then what is
  // left of the others' shares.
  struct alignas(64) Share {
    std::atomic<std::size_t> next{0};
    std::size_t end = 0;
  };

  // Rounded up: where there are few items the caller, who is there first, has one.
  std::size_t share_begin(std::size_t n_items, std::size_t share) const {
    return (n_items * share + n_shares_ - 1) / n_shares_;
  }

  void take_items(std::size_t number) {
    inside_region = true;
    for (std::size_t turn = 0; turn < n_shares_; ++turn) {
      Share& share = shares_[(number + turn) % n_shares_];
      // A look before each take: counters of shares that are used up stay in every cache.
      while (share.next.load(std::memory_order_relaxed) < share.end) {
        const std::size_t item = share.next.fetch_add(1, std::memory_order_relaxed);
        if (item >= share.end) break;
        try {
          (*body_)(item);
        } catch (...) {
          std::lock_guard<std::mutex> lock(mutex_);
          if (!error_) error_ = std::current_exception();
        }
      }
    }
    inside_region = false;
  }

  void work(std::size_t number) {
    std::size_t seen = 0;
    for (;;) {
      const auto give_up = std::chrono::steady_clock::now() + kSpinTime;
      for (int spins = 1; generation_.load(std::memory_order_acquire) == seen; ++spins) {
        pause_cpu();
        if (spins % 64 != 0 || std::chrono::steady_clock::now() < give_up) continue;
        std::unique_lock<std::mutex> lock(mutex_);
        sleepers_.fetch_add(1, std::memory_order_release);
        wake_.wait(lock, [&] { return generation_.load(std::memory_order_acquire) != seen; });
        sleepers_.fetch_sub(1, std::memory_order_release);
        break;
      }
      seen = generation_.load(std::memory_order_acquire);
      if (number < n_shares_) take_items(number);
      busy_.fetch_sub(1, std::memory_order_release);
    }
  }

  std::vector<std::thread> workers_;
  std::vector<Share> shares_;
  std::mutex region_, mutex_;
  std::condition_variable wake_;
  std::atomic<std::size_t> generation_{0}, busy_{0}, sleepers_{0};
  const std::function<void(std::size_t)>* body_ = nullptr;
  std::size_t n_shares_ = 1;
  std::exception_ptr error_;
};

// Made when first needed and never taken down: its threads end with the process. A forked child
// has none of its parent's threads and makes a pool of its own.
Pool& pool() {
  static std::mutex mutex;
  static Pool* instance = nullptr;
  static pid_t owner = 0;
  std::lock_guard<std::mutex> lock(mutex);
  if (!instance || owner != getpid()) {
    instance = new Pool(thread_count());
    owner = getpid();
  }
  return *instance;
}

// Cores that the container may use by its quota (control groups, version 2 then 1): threads beyond
// it would spin away the time of those that work.
std::size_t quota() {
  double limit = 0, period = 0;
  if (std::ifstream file("/sys/fs/cgroup/cpu.max"); file >> limit >> period) {
  } else {
    std::ifstream quota_file("/sys/fs/cgroup/cpu/cpu.cfs_quota_us");
    std::ifstream period_file("/sys/fs/cgroup/cpu/cpu.cfs_period_us");
    if (!(quota_file >> limit && period_file >> period)) return SIZE_MAX;
  }
  if (!(limit > 0 && period > 0)) return SIZE_MAX;
  return static_cast<std::size_t>(std::max(1.0, std::ceil(limit / period)));
}

std::size_t count_threads() {
  if (const char* text = std::getenv("TLEDFACE_NUM_THREADS"); text && *text) {
    char* end = nullptr;
    const long wanted = std::strtol(text, &end, 10);
    if (*end != '\0' || wanted < 1 || wanted > 4096)
      throw InputError("TLEDFACE_NUM_THREADS: got '" + std::string(text) +
                       "', allowed is a whole number from 1 to 4096; unset it to use every core");
    return static_cast<std::size_t>(wanted);
  }
  std::size_t count = std::max(1u, std::thread::hardware_concurrency());
  cpu_set_t allowed;
  CPU_ZERO(&allowed);
  if (sched_getaffinity(0, sizeof allowed, &allowed) == 0 && CPU_COUNT(&allowed) > 0)
    count = static_cast<std::size_t>(CPU_COUNT(&allowed));
  return std::min(count, quota());
}

}  // namespace

std::size_t thread_count() {
  static const std::size_t count = count_threads();
  return count;
}

void limit_threads(std::size_t most) { thread_limit = most ? most : SIZE_MAX; }

void parallel_for(std::size_t n_items, const std::function<void(std::size_t)>& body) {
  if (n_items <= 1 || inside_region || thread_count() == 1 || thread_limit.load() == 1) {
    for (std::size_t item = 0; item < n_items; ++item) body(item);
    return;
  }
  pool().run(n_items, body);
}

void parallel_for_chunks(std::size_t n_items, std::size_t grain,
                         const std::function<void(std::size_t, std::size_t)>& body) {
  if (grain == 0) grain = 1;
  const std::size_t n_chunks = (n_items + grain - 1) / grain;
  parallel_for(n_chunks, [&](std::size_t chunk) {
    const std::size_t begin = chunk * grain;
    body(begin, begin + grain < n_items ? begin + grain : n_items);
  });
}

}  // namespace tledface
