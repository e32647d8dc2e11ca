#include "sim/band_balance.hpp"

#include <algorithm>
#include <utility>

namespace tledface {
namespace {

// What bands are cut by. More launches follow the machine more slowly: what slows a core that
// another system has a share of changes within a millisecond. With 50 a body of 15 000 elements
// gains nothing.
constexpr int kLaunches = 4;
// Share of what a launch takes that new bands must save.
constexpr double kWorthwhile = 0.02;
// Of the speeds found last; the rest is what was known before.
constexpr double kNewest = 0.5;

}  // namespace

BandBalance::BandBalance(const std::vector<double>& work, std::int32_t n_y, std::size_t n_bands)
    : dealer_(work, n_y), bands_(dealer_.deal(std::vector<double>(n_bands, 1.0))) {
  seconds_.assign(this->n_bands(), 0);
  total_ = seconds_;
  speeds_.assign(this->n_bands(), 1);
}

double BandBalance::slowest(const std::vector<std::int32_t>& bands) const {
  double most = 0;
  for (std::size_t i = 0; i < speeds_.size(); ++i)
    most = std::max(most, dealer_.work(bands[2 * i], bands[2 * i + 1]) / speeds_[i]);
  return most;
}

bool BandBalance::enter() {
  if (n_bands() < 2) return false;
  for (std::size_t i = 0; i < total_.size(); ++i) total_[i] += seconds_[i];
  if (++n_entered_ < kLaunches) return false;
  // Relative to each other: all together may be faster now than before.
  std::vector<double> found(total_.size());
  double mean = 0;
  for (std::size_t i = 0; i < found.size(); ++i) {
    const double work = dealer_.work(bands_[2 * i], bands_[2 * i + 1]);
    found[i] = work > 0 && total_[i] > 0 ? work / total_[i] : 0;
    mean += found[i] / static_cast<double>(found.size());
  }
  std::fill(total_.begin(), total_.end(), 0.0);
  n_entered_ = 0;
  for (std::size_t i = 0; i < found.size(); ++i)
    // A band of nothing tells nothing.
    if (found[i] > 0) speeds_[i] += kNewest * (found[i] / mean - speeds_[i]);
  std::vector<std::int32_t> bands = dealer_.deal(speeds_);
  if (slowest(bands) > (1 - kWorthwhile) * slowest(bands_)) return false;
  bands_ = std::move(bands);
  return true;
}

}  // namespace tledface
