// The constitutive laws that were compiled in, numbered as in the generated kernels_cl/laws.cl.
#pragma once
#include <cstdint>
#include <string>

namespace tledface {

struct LawInfo {
  const char* name;
  int rows;        // of lanes, the weight included
  int history;     // rows of lanes kept from step to step
  int vectors[4];  // rows where a vector begins (x, y, z follow each other), 0 behind the last
};

std::int32_t n_laws();
const LawInfo& law_info(std::int32_t number);
// Throws InputError for a name that is not there.
std::int32_t law_number(const std::string& name);

}  // namespace tledface
