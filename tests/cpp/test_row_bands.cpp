// Bands of rows: dealt so that the slowest is done early, cut anew as threads turn out faster or
// slower, and no bit of a run depends on it. Exit status 0 when every check holds.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <numeric>
#include <vector>

#include "backend/device.hpp"
#include "bench/checks.hpp"
#include "bench/workloads.hpp"
#include "core/threads.hpp"
#include "precompute/row_table.hpp"
#include "sim/band_balance.hpp"

using namespace tledface;

namespace {

int failures = 0;

#define CHECK(condition)                                                           \
  do {                                                                             \
    if (!(condition)) {                                                            \
      std::fprintf(stderr, "%s:%d: failed: %s\n", __FILE__, __LINE__, #condition); \
      ++failures;                                                                  \
    }                                                                              \
  } while (false)

using Bands = std::vector<std::int32_t>;

bool each_row_is_in_one_band(const Bands& bands, std::int32_t n_rows) {
  std::int32_t y = 0;
  for (std::size_t i = 0; i < bands.size(); i += 2) {
    if (bands[i] != y || bands[i + 1] <= y) return false;
    y = bands[i + 1];
  }
  return y == n_rows;
}

double slowest(const RowDealer& dealer, const Bands& bands, const std::vector<double>& speeds) {
  double most = 0;
  for (std::size_t i = 0; i < bands.size() / 2; ++i)
    most = std::max(most, dealer.work(bands[2 * i], bands[2 * i + 1]) / speeds[i]);
  return most;
}

// Every way to cut, one after the other.
double best_of_all(const RowDealer& dealer, const std::vector<double>& speeds) {
  double best = INFINITY;
  for (std::int32_t a = 1; a < dealer.n_rows() - 1; ++a)
    for (std::int32_t b = a + 1; b < dealer.n_rows(); ++b)
      best = std::min(best, slowest(dealer, {0, a, a, b, b, dealer.n_rows()}, speeds));
  return best;
}

void test_no_other_cut_is_faster() {
  std::vector<double> work(37);
  for (std::size_t y = 0; y < work.size(); ++y) work[y] = 1 + double(y * y * 7919 % 23);
  work[7] = work[8] = 0;
  const RowDealer dealer(work);
  for (const std::vector<double>& speeds :
       {std::vector<double>{1, 1, 1}, {1, 0.4, 1}, {0.2, 1.5, 1.3}, {1, 1, 1e-6}}) {
    const Bands bands = dealer.deal(speeds);
    CHECK(bands.size() == 6);
    CHECK(each_row_is_in_one_band(bands, 37));
    CHECK(slowest(dealer, bands, speeds) <= 1.002 * best_of_all(dealer, speeds));
  }
}

void test_more_bands_than_rows_are_as_many_as_rows() {
  const RowDealer dealer({3, 0, 1});
  for (const std::size_t n : {std::size_t(1), std::size_t(2), std::size_t(3), std::size_t(8)}) {
    const Bands bands = dealer.deal(std::vector<double>(n, 1.0));
    CHECK(bands.size() == 2 * std::min<std::size_t>(n, 3));
    CHECK(each_row_is_in_one_band(bands, 3));
  }
}

void launch(BandBalance& balance, const RowDealer& dealer, const std::vector<double>& speeds) {
  for (std::size_t i = 0; i < speeds.size(); ++i)
    balance.seconds()[i] =
        1e-4 * dealer.work(balance.bands()[2 * i], balance.bands()[2 * i + 1]) / speeds[i];
  balance.enter();
}

// Two threads, one of which is slowed down and later as fast as the other again.
void test_bands_follow_their_threads() {
  const std::vector<double> work(100, 1.0);
  const RowDealer dealer(work);
  BandBalance balance(work, 2);
  // The upper one computes a row of the lower once more.
  CHECK(std::abs(balance.bands()[1] - 50) <= 1);
  for (int i = 0; i < 200; ++i) launch(balance, dealer, {1, 1});
  CHECK(std::abs(balance.bands()[1] - 50) <= 1);
  for (int i = 0; i < 200; ++i) launch(balance, dealer, {1, 0.5});
  CHECK(std::abs(balance.bands()[1] - 67) <= 1);
  for (int i = 0; i < 200; ++i) launch(balance, dealer, {1, 1});
  CHECK(std::abs(balance.bands()[1] - 50) <= 1);
  // Both at once as slow: nothing to gain.
  const Bands before = balance.bands();
  for (int i = 0; i < 200; ++i) launch(balance, dealer, {0.1, 0.1});
  CHECK(balance.bands() == before);
}

// More threads than cores, so that bands move all the time, against one band.
void test_moving_bands_change_no_bit() {
  const bench::Workload face = bench::make_workload("face", 6000);
  std::vector<std::uint8_t> expected;
  for (const std::size_t n_bands : {std::size_t(1), std::size_t(5), std::size_t(0)}) {
    SimulatorOptions options;
    options.n_bands = n_bands;
    bench::Run run(make_native_device(), face, options);
    run.advance(1500);
    run.finish();
    const std::vector<std::uint8_t> u = run.simulator().raw_state().u;
    if (expected.empty()) expected = u;
    CHECK(u == expected);
  }
  CHECK(std::any_of(expected.begin(), expected.end(), [](std::uint8_t byte) { return byte != 0; }));
}

}  // namespace

int main() {
  setenv("TLEDFACE_NUM_THREADS", "5", 1);
  test_no_other_cut_is_faster();
  test_more_bands_than_rows_are_as_many_as_rows();
  test_bands_follow_their_threads();
  test_moving_bands_change_no_bit();
  if (failures == 0) std::puts("test_row_bands: every check holds");
  return failures == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
}
