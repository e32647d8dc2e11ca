// The OpenCL devices of this process in the order of their ids. Probing compiles kernels, which can
// take seconds a device, so it happens when a device is first asked for and once a process.
#pragma once
#include <vector>

#include "backend/device.hpp"

namespace tledface {

// Without probing: `works` and `reason` may be stale, the rest is final.
std::vector<DeviceInfo> list_opencl_devices();

// The device with its probe run; `index` must be below the number of listed devices.
DeviceInfo probe_opencl_device(std::size_t index);

}  // namespace tledface
