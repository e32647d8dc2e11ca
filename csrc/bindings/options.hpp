// Options that Python gives as words and tuples.
#pragma once
#include <array>
#include <initializer_list>
#include <string>
#include <utility>

#include "backend/device.hpp"
#include "core/error.hpp"
#include "precompute/solver_arrays.hpp"
#include "sim/force_path.hpp"

namespace tledface {

template <class T>
T pick(const char* option, const std::string& got,
       std::initializer_list<std::pair<const char*, T>> known) {
  std::string allowed;
  for (const auto& [name, value] : known) {
    if (got == name) return value;
    allowed += (allowed.empty() ? "'" : ", '") + std::string(name) + "'";
  }
  throw InputError(std::string(option) + ": got '" + got + "', allowed are " + allowed);
}

inline Precision pick_precision(const std::string& got) {
  return pick<Precision>("precision", got,
                         {{"single", Precision::kSingle}, {"double", Precision::kDouble}});
}

inline HourglassForm pick_hourglass(const std::string& got) {
  return pick<HourglassForm>(
      "hourglass", got,
      {{"physical", HourglassForm::kPhysical}, {"joldes", HourglassForm::kKappa}});
}

inline KernelPath pick_kernels(const std::string& got) {
  return pick<KernelPath>("kernels", got,
                          {{"auto", KernelPath::kAuto},
                           {"rows", KernelPath::kRows},
                           {"gather", KernelPath::kGather},
                           {"tile", KernelPath::kTile}});
}

inline TileShape make_tile(const std::array<int, 3>& given) {
  TileShape tile;
  tile.width = given[0];
  tile.rows = given[1];
  tile.depth = given[2];
  return tile;
}

}  // namespace tledface
