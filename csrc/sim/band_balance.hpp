// Bands of cells that follow the threads: cut anew while a run goes on, by how long each took,
// where the executor can tell. Cores differ, above all where others work on them too, and the
// slowest band is what a step takes. How cells are dealt changes no bit of a result.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "precompute/row_table.hpp"

namespace tledface {

class BandBalance {
 public:
  BandBalance() : dealer_({}, 1) {}
  BandBalance(const std::vector<double>& work, std::int32_t n_y, std::size_t n_bands);
  const std::vector<std::int32_t>& bands() const { return bands_; }  // 2 per band
  std::size_t n_bands() const { return bands_.size() / 2; }
  // Where a launch leaves the seconds of each band.
  double* seconds() { return seconds_.data(); }
  // Enters a launch. True: bands() are others now.
  bool enter();

 private:
  double slowest(const std::vector<std::int32_t>& bands) const;

  RowDealer dealer_;
  std::vector<std::int32_t> bands_;
  std::vector<double> seconds_, total_, speeds_;
  int n_entered_ = 0;
};

}  // namespace tledface
