// Row sets of kernels_cl/layout.cl: equal ones are stored once.
#pragma once
#include <cstddef>
#include <cstdint>
#include <string>
#include <unordered_map>
#include <vector>

namespace tledface {

// Sets of `reals` values each; add() gives a set's number.
class RowSets {
 public:
  RowSets(std::size_t reals, std::vector<double>& storage) : reals_(reals), storage_(storage) {}

  std::int32_t add(const std::vector<double>& set) {
    const std::string bytes(reinterpret_cast<const char*>(set.data()), reals_ * sizeof(double));
    const auto [it, is_new] = index_.emplace(bytes, static_cast<std::int32_t>(index_.size()));
    if (is_new) storage_.insert(storage_.end(), set.begin(), set.end());
    return it->second;
  }

 private:
  std::size_t reals_;
  std::vector<double>& storage_;
  std::unordered_map<std::string, std::int32_t> index_;
};

}  // namespace tledface
