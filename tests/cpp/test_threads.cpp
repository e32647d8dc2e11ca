// The thread pool: every item once, errors rethrown, calls from within bodies and from several
// threads at once. Exit status 0 when every check holds; a check that fails says where.
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <mutex>
#include <set>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "check.hpp"
#include "core/threads.hpp"

using namespace tledface;

namespace {

bool each_item_runs_once(std::size_t n_items) {
  std::vector<std::atomic<int>> runs(n_items);
  parallel_for(n_items, [&](std::size_t item) { ++runs[item]; });
  for (const auto& count : runs)
    if (count != 1) return false;
  return true;
}

void test_item_counts() {
  for (const std::size_t n_items : {0, 1, 2, 3, 7, 1000, 100000})
    CHECK(each_item_runs_once(n_items));
}

// As many threads as allowed, and every item once.
void test_a_limit_holds() {
  for (const std::size_t most : {std::size_t(1), std::size_t(2), std::size_t(0)}) {
    limit_threads(most);
    std::mutex mutex;
    std::set<std::thread::id> seen;
    for (int region = 0; region < 50; ++region)
      parallel_for(64, [&](std::size_t) {
        std::lock_guard<std::mutex> lock(mutex);
        seen.insert(std::this_thread::get_id());
      });
    CHECK(seen.size() <= (most ? most : thread_count()));
    CHECK(most != 1 || seen.count(std::this_thread::get_id()) == 1);
    CHECK(each_item_runs_once(1000));
  }
  limit_threads(0);
}

// In every region a thread has its own share of the items, whose data its core still holds, as long
// as it is not late. Bodies sleep, so that a busy machine does not decide.
void test_items_stay_with_their_thread() {
  constexpr std::size_t kItems = 8;
  constexpr int kRegions = 12;
  if (thread_count() < 2) return;
  limit_threads(2);
  const auto caller = std::this_thread::get_id();
  std::vector<std::thread::id> by(kItems);
  int own = 0;
  for (int region = 0; region < kRegions; ++region) {
    parallel_for(kItems, [&](std::size_t item) {
      by[item] = std::this_thread::get_id();
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    });
    for (std::size_t item = 0; item < kItems; ++item)
      own += (by[item] == caller) == (item < kItems / 2);
  }
  limit_threads(0);
  CHECK(own >= 0.8 * kRegions * kItems);
}

void test_chunks_cover_the_range() {
  for (const std::size_t n_items : {0, 1, 9, 10, 11, 1001})
    for (const std::size_t grain : {0, 1, 10, 5000}) {
      std::vector<std::atomic<int>> runs(n_items);
      std::atomic<bool> within{true};
      parallel_for_chunks(n_items, grain, [&](std::size_t begin, std::size_t end) {
        if (begin >= end || end > n_items || end - begin > (grain ? grain : 1)) within = false;
        for (std::size_t item = begin; item < end && item < n_items; ++item) ++runs[item];
      });
      CHECK(within);
      for (const auto& count : runs) CHECK(count == 1);
    }
}

// Regions follow each other at once (workers spin) and after pauses (workers sleep).
void test_many_regions() {
  constexpr long n_regions = 2000;
  std::vector<long> sums(64, 0);
  for (long region = 0; region < n_regions; ++region) {
    parallel_for(sums.size(), [&](std::size_t item) { sums[item] += region; });
    if (region % 200 == 0) std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  for (const long sum : sums) CHECK(sum == n_regions * (n_regions - 1) / 2);
}

void test_errors_reach_the_caller() {
  for (int repeat = 0; repeat < 100; ++repeat) {
    std::string message;
    std::atomic<int> others{0};
    try {
      parallel_for(50, [&](std::size_t item) {
        if (item == 33) throw std::runtime_error("item 33");
        ++others;
      });
    } catch (const std::runtime_error& error) {
      message = error.what();
    }
    CHECK(message == "item 33");
    CHECK(others == 49);
    CHECK(each_item_runs_once(50));
  }
}

void test_several_errors_give_one() {
  int caught = 0;
  try {
    parallel_for(50, [](std::size_t item) { throw std::runtime_error(std::to_string(item)); });
  } catch (const std::runtime_error&) {
    ++caught;
  }
  CHECK(caught == 1);
  CHECK(each_item_runs_once(50));
}

void test_calls_from_within_a_body_run_in_its_thread() {
  std::vector<std::atomic<int>> runs(20 * 30);
  std::atomic<bool> same_thread{true};
  parallel_for(20, [&](std::size_t outer) {
    const auto caller = std::this_thread::get_id();
    parallel_for(30, [&](std::size_t inner) {
      if (std::this_thread::get_id() != caller) same_thread = false;
      ++runs[30 * outer + inner];
    });
  });
  CHECK(same_thread);
  for (const auto& count : runs) CHECK(count == 1);
}

void test_errors_pass_through_nested_calls() {
  int caught = 0;
  try {
    parallel_for(8, [](std::size_t) {
      parallel_for(8, [](std::size_t inner) {
        if (inner == 5) throw std::runtime_error("inner");
      });
    });
  } catch (const std::runtime_error&) {
    ++caught;
  }
  CHECK(caught == 1);
  CHECK(each_item_runs_once(50));
}

void test_callers_in_several_threads() {
  std::atomic<bool> good{true};
  std::vector<std::thread> callers;
  for (int caller = 0; caller < 4; ++caller)
    callers.emplace_back([&] {
      for (int repeat = 0; repeat < 50; ++repeat)
        if (!each_item_runs_once(100)) good = false;
    });
  for (auto& caller : callers) caller.join();
  CHECK(good);
}

}  // namespace

int main() {
  // More threads than cores: workers are held up in the middle of regions.
  setenv("TLEDFACE_NUM_THREADS", "5", 1);
  CHECK(thread_count() == 5);
  test_item_counts();
  test_a_limit_holds();
  test_items_stay_with_their_thread();
  test_chunks_cover_the_range();
  test_many_regions();
  test_errors_reach_the_caller();
  test_several_errors_give_one();
  test_calls_from_within_a_body_run_in_its_thread();
  test_errors_pass_through_nested_calls();
  test_callers_in_several_threads();
  return finish("test_threads");
}
