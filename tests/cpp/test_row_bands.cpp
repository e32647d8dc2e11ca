// Bands of cells: dealt so that the slowest is done early, cut anew as threads turn out faster or
// slower, and no bit of a run depends on it. Exit status 0 when every check holds.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "backend/device.hpp"
#include "bench/checks.hpp"
#include "bench/workloads.hpp"
#include "check.hpp"
#include "core/threads.hpp"
#include "precompute/row_table.hpp"
#include "sim/band_balance.hpp"

using namespace tledface;

namespace {

using Bands = std::vector<std::int32_t>;

// Bands one behind the other, of as many cells as a chunk or more.
bool each_cell_is_in_one_band(const Bands& bands, std::int32_t n_cells, std::int32_t n_y) {
  std::int32_t cell = 0;
  for (std::size_t i = 0; i < bands.size(); i += 2) {
    if (bands[i] != cell || bands[i + 1] < cell + n_y) return false;
    cell = bands[i + 1];
  }
  return cell == n_cells;
}

double slowest(const RowDealer& dealer, const Bands& bands, const std::vector<double>& speeds) {
  double most = 0;
  for (std::size_t i = 0; i < bands.size() / 2; ++i)
    most = std::max(most, dealer.work(bands[2 * i], bands[2 * i + 1]) / speeds[i]);
  return most;
}

// Every way to cut, one after the other.
double best_of_all(const RowDealer& dealer, std::int32_t n_y, const std::vector<double>& speeds) {
  const std::int32_t n = dealer.n_cells();
  double best = INFINITY;
  for (std::int32_t a = n_y; a <= n - 2 * n_y; ++a)
    for (std::int32_t b = a + n_y; b <= n - n_y; ++b)
      best = std::min(best, slowest(dealer, {0, a, a, b, b, n}, speeds));
  return best;
}

void test_no_other_cut_is_faster() {
  for (const std::int32_t n_y : {1, 5}) {
    std::vector<double> work(std::size_t(37) * n_y);
    for (std::size_t i = 0; i < work.size(); ++i) work[i] = 1 + double(i * i * 7919 % 23);
    work[7] = work[8] = 0;
    const RowDealer dealer(work, n_y);
    for (const std::vector<double>& speeds :
         {std::vector<double>{1, 1, 1}, {1, 0.4, 1}, {0.2, 1.5, 1.3}, {1, 1, 1e-6}}) {
      const Bands bands = dealer.deal(speeds);
      CHECK(bands.size() == 6);
      CHECK(each_cell_is_in_one_band(bands, 37 * n_y, n_y));
      CHECK(slowest(dealer, bands, speeds) <= 1.002 * best_of_all(dealer, n_y, speeds));
    }
  }
}

// A chunk and one are computed once more.
void test_work_of_a_band_includes_its_seeds() {
  std::vector<double> work(30);
  for (std::size_t i = 0; i < work.size(); ++i) work[i] = std::ldexp(1.0, int(i));
  const RowDealer dealer(work, 6);
  CHECK(dealer.work(0, 7) == 127);
  CHECK(dealer.work(20, 30) == std::ldexp(1.0, 30) - std::ldexp(1.0, 13));
}

void test_more_bands_than_chunks_are_as_many_as_chunks() {
  const RowDealer dealer({3, 0, 1, 2, 0, 0}, 2);
  for (const std::size_t n : {std::size_t(1), std::size_t(2), std::size_t(3), std::size_t(8)}) {
    const Bands bands = dealer.deal(std::vector<double>(n, 1.0));
    CHECK(bands.size() == 2 * std::min<std::size_t>(n, 3));
    CHECK(each_cell_is_in_one_band(bands, 6, 2));
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
  const RowDealer dealer(work, 1);
  BandBalance balance(work, 1, 2);
  // The second one computes some of the first once more.
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

// The native device, but that what its kernels say of their items' time is made up: bands of rows
// are dealt anew all the time. Counts the launches that were timed.
class UnsteadyKernel final : public Kernel {
 public:
  UnsteadyKernel(std::unique_ptr<Kernel> kernel, int& n_timed)
      : kernel_(std::move(kernel)), n_timed_(n_timed) {}
  void set_arg(unsigned index, const Buffer& buffer) override { kernel_->set_arg(index, buffer); }
  void set_arg(unsigned index, std::int32_t value) override { kernel_->set_arg(index, value); }
  void set_local(unsigned index, std::size_t bytes) override { kernel_->set_local(index, bytes); }
  std::size_t largest_group() const override { return kernel_->largest_group(); }
  void enqueue(std::size_t n_items, std::size_t local_size) override {
    kernel_->enqueue(n_items, local_size);
    if (!seconds_) return;
    for (std::size_t i = 0; i < n_items; ++i)
      seconds_[i] = 1e-3 * double(1 + (7919 * i + 104729 * (n_timed_ / 16)) % 5);
    ++n_timed_;
  }
  bool time_items(double* seconds) override {
    seconds_ = seconds;
    return true;
  }

 private:
  std::unique_ptr<Kernel> kernel_;
  int& n_timed_;
  double* seconds_ = nullptr;
};

class UnsteadyProgram final : public Program {
 public:
  UnsteadyProgram(std::unique_ptr<Program> program, int& n_timed)
      : program_(std::move(program)), n_timed_(n_timed) {}
  std::unique_ptr<Kernel> kernel(const std::string& name) override {
    return std::make_unique<UnsteadyKernel>(program_->kernel(name), n_timed_);
  }

 private:
  std::unique_ptr<Program> program_;
  int& n_timed_;
};

class UnsteadyDevice final : public Device {
 public:
  const DeviceInfo& info() const override { return device_->info(); }
  bool prefers_vector_rows() const override { return true; }
  int preferred_lanes(Precision precision) const override {
    return device_->preferred_lanes(precision);
  }
  bool times_items() const override { return true; }
  std::unique_ptr<Buffer> allocate(std::size_t bytes) override { return device_->allocate(bytes); }
  std::unique_ptr<Program> build(const ProgramOptions& options) override {
    return std::make_unique<UnsteadyProgram>(device_->build(options), n_timed);
  }
  void finish() override { device_->finish(); }
  int n_timed = 0;

 private:
  std::shared_ptr<Device> device_ = make_native_device();
};

std::vector<std::uint8_t> after_steps(std::shared_ptr<Device> device, const bench::Workload& body,
                                      std::size_t n_bands, int substeps) {
  SimulatorOptions options;
  options.n_bands = n_bands;
  bench::Run run(std::move(device), body, options);
  if (substeps > 1) {
    run.simulator().limit_now({std::vector<double>(run.simulator().model().muscles.size(), 0.0)},
                              0);
    run.simulator().set_substeps(substeps);
    run.simulator().choose_levels();
    CHECK(run.simulator().levels().n_levels > 1);
  }
  run.advance(480);
  run.finish();
  return run.simulator().raw_state().u;
}

// Against one band that stays; with sliding nodes, and with rows of which not all are due.
void test_moving_bands_change_no_bit() {
  const bench::Workload face = bench::make_workload("face", 6000);
  for (const int substeps : {1, 4}) {
    const auto expected = after_steps(make_native_device(), face, 1, substeps);
    CHECK(std::any_of(expected.begin(), expected.end(), [](auto byte) { return byte != 0; }));
    for (const std::size_t n_bands : {std::size_t(0), std::size_t(2), std::size_t(7)}) {
      const auto device = std::make_shared<UnsteadyDevice>();
      CHECK(after_steps(device, face, n_bands, substeps) == expected);
      CHECK(device->n_timed >= 480);
    }
  }
}

}  // namespace

int main() {
  setenv("TLEDFACE_NUM_THREADS", "5", 1);
  test_no_other_cut_is_faster();
  test_work_of_a_band_includes_its_seeds();
  test_more_bands_than_chunks_are_as_many_as_chunks();
  test_bands_follow_their_threads();
  test_moving_bands_change_no_bit();
  return finish("test_row_bands");
}
