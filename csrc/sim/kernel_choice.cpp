#include "sim/kernel_choice.hpp"

#include <map>
#include <mutex>
#include <set>
#include <tuple>

namespace tledface {
namespace {

using Key = std::tuple<std::string, Precision, HourglassForm>;

std::mutex mutex;

std::map<Key, KernelChoice>& choices() {
  static std::map<Key, KernelChoice> map;
  return map;
}

std::set<std::string>& recording_devices() {
  static std::set<std::string> set;
  return set;
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

void choose_recording(const std::string& device, bool recorded) {
  std::lock_guard<std::mutex> lock(mutex);
  if (recorded)
    recording_devices().insert(device);
  else
    recording_devices().erase(device);
}

bool chosen_recording(const std::string& device) {
  std::lock_guard<std::mutex> lock(mutex);
  return recording_devices().count(device) > 0;
}

}  // namespace tledface
