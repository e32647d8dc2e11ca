#include "backend/roofline.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <string>

#include "core/error.hpp"

namespace tledface {
namespace {

using Clock = std::chrono::steady_clock;

constexpr int kChains = 14;        // of roofline_mixed
constexpr int kRepeats = 4;        // of all chains an iteration of its inner loops
constexpr int kMostAdding = 8;     // chains
constexpr int kLargestPeriod = 8;  // iterations of the two inner loops together
constexpr int kRounds = 2000;
// Bytes of both arrays that a launch of axpy goes over at least, in several passes if need be.
constexpr std::size_t kBytesALaunch = std::size_t(32) << 20;
// Pieces of an array: enough to level threads out; and work-items that fill any GPU.
constexpr std::size_t kPiecesPerUnit = 8, kItemsPerUnit = 2048, kGroupSize = 64;

double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

}  // namespace

// A kernel and how many of its launches take how long.
struct Roofline::Block {
  std::unique_ptr<Kernel> kernel;
  std::size_t n_items, local_size;
  double seconds_a_launch = 0;
};

Roofline::Roofline(std::shared_ptr<Device> device, Precision precision, std::size_t bytes,
                   const InstructionMix& mix)
    : device_(std::move(device)), precision_(precision) {
  if (!(mix.fused > 0) || mix.multiplied < 0 || mix.added < 0 || !std::isfinite(mix.total()))
    throw InputError("roofline: the mix needs some multiply-adds and no negative count");
  const bool rows = device_->prefers_vector_rows();
  ProgramOptions options;
  options.precision = precision;
  options.lanes = device_->preferred_lanes(precision);
  options.vector_rows = rows;
  options.file = "roofline.cl";
  program_ = device_->build(options);
  const std::size_t real = real_size(precision), width = rows ? options.lanes : 1,
                    units = device_->info().compute_units, local = rows ? 1 : kGroupSize;
  n_items_ = units * (rows ? kPiecesPerUnit : kItemsPerUnit);
  const std::size_t n_rows = std::max(n_items_, bytes / (2 * real * width));
  n_reals_ = n_rows * width;
  if (n_rows > 0x7fffffff) throw InputError("roofline: the arrays are larger than can be indexed");
  x_ = device_->allocate(n_reals_ * real);
  y_ = device_->allocate(n_reals_ * real);
  const auto memory_block = [&](const std::string& name) {
    auto block = std::make_unique<Block>(Block{program_->kernel(name), n_items_, local});
    block->kernel->set_arg(0, *x_);
    block->kernel->set_arg(1, *y_);
    block->kernel->set_arg(2, static_cast<std::int32_t>(n_rows));
    block->kernel->set_arg(3, static_cast<std::int32_t>(n_items_));
    return block;
  };
  axpy_ = memory_block("roofline_axpy");
  axpy_passes_ = std::max<std::size_t>(1, kBytesALaunch / (2 * n_reals_ * real));
  axpy_->kernel->set_arg(4, static_cast<std::int32_t>(axpy_passes_));
  copy_ = memory_block("roofline_copy");

  // The nearest mix of whole chains and iterations.
  const double multiplying = mix.fused + mix.multiplied, share = mix.fused / multiplying;
  int fused = 1, period = 1;
  for (int n = 1; n <= kLargestPeriod; ++n) {
    const int f = std::clamp(static_cast<int>(std::lround(share * n)), 1, n);
    if (std::abs(share - double(f) / n) + 1e-9 < std::abs(share - double(fused) / period))
      fused = f, period = n;
  }
  const int adding =
      std::clamp(static_cast<int>(std::lround(kChains * mix.added / mix.total())), 0, kMostAdding);
  const int others = kChains - adding;
  mix_ = {double(fused) * others, double(period - fused) * others, double(period) * adding};
  arithmetic_items_ = units * (rows ? kPiecesPerUnit : kItemsPerUnit);
  instructions_a_launch_ =
      mix_.total() * kRepeats * kRounds * double(arithmetic_items_) * double(width);
  out_ = device_->allocate(2 * arithmetic_items_ * width * real);
  mixed_ =
      std::make_unique<Block>(Block{program_->kernel("roofline_mixed"), arithmetic_items_, local});
  mixed_->kernel->set_arg(0, *out_);
  unsigned argument = 1;
  for (const int value :
       {static_cast<int>(arithmetic_items_), kRounds, fused, period - fused, adding})
    mixed_->kernel->set_arg(argument++, static_cast<std::int32_t>(value));
}

Roofline::~Roofline() { device_->finish(); }

double Roofline::launches_per_second(Block& block, double seconds) {
  const auto run = [&](int launches) {
    device_->finish();
    const auto begin = Clock::now();
    for (int i = 0; i < launches; ++i) block.kernel->enqueue(block.n_items, block.local_size);
    device_->finish();
    return seconds_since(begin) / launches;
  };
  if (block.seconds_a_launch == 0) {
    run(1);
    block.seconds_a_launch = run(1);
  }
  const double wanted = seconds / std::max(block.seconds_a_launch, 1e-7);
  const double taken = run(static_cast<int>(std::clamp(wanted, 1.0, 1e6)));
  // A launch that was held up would shorten all later blocks.
  block.seconds_a_launch = std::min(block.seconds_a_launch, taken);
  return 1 / taken;
}

double Roofline::axpy(double seconds) {
  return 3 * double(n_reals_ * real_size(precision_)) * double(axpy_passes_) *
         launches_per_second(*axpy_, seconds) / 1e9;
}

double Roofline::copy(double seconds) {
  return 2 * double(n_reals_ * real_size(precision_)) * launches_per_second(*copy_, seconds) / 1e9;
}

double Roofline::instructions(double seconds) {
  return instructions_a_launch_ * launches_per_second(*mixed_, seconds) / 1e9;
}

}  // namespace tledface
