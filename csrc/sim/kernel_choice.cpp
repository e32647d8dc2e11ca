#include "sim/kernel_choice.hpp"

#include <map>
#include <mutex>
#include <tuple>

namespace tledface {
namespace {

using Key = std::tuple<std::string, Precision, HourglassForm>;

std::mutex mutex;

std::map<Key, KernelChoice>& choices() {
  static std::map<Key, KernelChoice> map;
  return map;
}

}  // namespace

void choose_kernels(const std::string& device, Precision precision, HourglassForm hourglass,
                    const std::optional<KernelChoice>& choice) {
  std::lock_guard<std::mutex> lock(mutex);
  if (choice)
    choices()[{device, precision, hourglass}] = *choice;
  else
    choices().erase({device, precision, hourglass});
}

std::optional<KernelChoice> chosen_kernels(const std::string& device, Precision precision,
                                           HourglassForm hourglass) {
  std::lock_guard<std::mutex> lock(mutex);
  const auto found = choices().find({device, precision, hourglass});
  if (found == choices().end()) return std::nullopt;
  return found->second;
}

}  // namespace tledface
