// What KernelPath::kAuto means on a device, where someone has measured it
// (python/tledface/autotune.py). Of this process; any thread may ask.
#pragma once
#include <optional>
#include <string>

#include "sim/force_path.hpp"

namespace tledface {

struct KernelChoice {
  KernelPath path = KernelPath::kGather;
  TileShape tile;
  int registers = 0;
};

// device: its id. Nothing: the device's own preference holds.
void choose_kernels(const std::string& device, Precision precision, HourglassForm hourglass,
                    const std::optional<KernelChoice>& choice);
std::optional<KernelChoice> chosen_kernels(const std::string& device, Precision precision,
                                           HourglassForm hourglass);

// Whether runs of steps are recorded and replayed (SimulatorOptions::recorded); false until told.
void choose_recording(const std::string& device, bool recorded);
bool chosen_recording(const std::string& device);

}  // namespace tledface
