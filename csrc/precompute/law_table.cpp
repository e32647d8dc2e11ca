#include "precompute/law_table.hpp"

#include "core/error.hpp"

namespace tledface {
namespace {

constexpr LawInfo kLaws[] = {
#include "precompute/law_table.inc"
};

}  // namespace

std::int32_t n_laws() { return static_cast<std::int32_t>(sizeof kLaws / sizeof kLaws[0]); }

const LawInfo& law_info(std::int32_t number) { return kLaws[number]; }

std::int32_t law_number(const std::string& name) {
  std::string known;
  for (std::int32_t i = 0; i < n_laws(); ++i) {
    if (name == kLaws[i].name) return i;
    known += (i ? ", " : "") + std::string(kLaws[i].name);
  }
  throw InputError("law '" + name + "': not compiled in; there are " + known);
}

}  // namespace tledface
