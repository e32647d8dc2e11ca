// Choice of an executor by name; see device.hpp.
#include <algorithm>

#include "backend/device.hpp"
#include "backend/opencl/registry.hpp"
#include "core/error.hpp"

namespace tledface {
namespace {

// "opencl:0 (pthread-…), native"
std::string names_of(const std::vector<DeviceInfo>& devices) {
  std::string names;
  for (const auto& device : devices) names += device.id + " (" + device.name + "), ";
  return names + "native";
}

std::shared_ptr<Device> open_auto() {
  const auto devices = list_opencl_devices();
  for (std::size_t index = 0; index < devices.size(); ++index)
    if (devices[index].kind == "gpu" && probe_opencl_device(index).works)
      return make_opencl_device(index);
  return make_native_device();
}

std::shared_ptr<Device> open_first_opencl() {
  const auto devices = list_opencl_devices();
  if (devices.empty())
    throw InputError("device 'opencl': no OpenCL device here (library: " + opencl_loader_report() +
                     "); use 'native', or install a driver and run `tledface doctor`");
  std::vector<std::size_t> order(devices.size());
  for (std::size_t index = 0; index < order.size(); ++index) order[index] = index;
  std::stable_partition(order.begin(), order.end(),
                        [&](std::size_t index) { return devices[index].kind == "gpu"; });
  std::string reasons;
  for (const std::size_t index : order) {
    const DeviceInfo info = probe_opencl_device(index);
    if (info.works) return make_opencl_device(index);
    reasons += (reasons.empty() ? "" : "; ") + info.id + " (" + info.name + "): " + info.reason;
  }
  throw InputError("device 'opencl': none of the listed devices works: " + reasons +
                   "; use 'native', see `tledface doctor`");
}

// The number behind "opencl:", or -1.
long opencl_index(const std::string& spec) {
  const std::string prefix = "opencl:";
  if (spec.rfind(prefix, 0) != 0) return -1;
  const std::string digits = spec.substr(prefix.size());
  if (digits.empty() || digits.size() > 4 ||
      digits.find_first_not_of("0123456789") != std::string::npos)
    return -1;
  return std::stol(digits);
}

}  // namespace

std::vector<DeviceInfo> all_devices() {
  std::vector<DeviceInfo> devices = opencl_devices();
  devices.insert(devices.begin(), native_device_info());
  return devices;
}

std::shared_ptr<Device> open_device(const std::string& spec) {
  if (spec == "auto") return open_auto();
  if (spec == "native") return make_native_device();
  if (spec == "opencl") return open_first_opencl();
  const long index = opencl_index(spec);
  if (index < 0)
    throw InputError("device '" + spec +
                     "': unknown; allowed are auto, native, opencl and opencl:N with a number; "
                     "run `tledface doctor` for a list");
  const auto devices = list_opencl_devices();
  if (static_cast<std::size_t>(index) >= devices.size()) {
    const std::string library =
        devices.empty() ? " (OpenCL library: " + opencl_loader_report() + ")" : std::string();
    throw InputError("device '" + spec + "': no such device; there are " + names_of(devices) +
                     library + "; run `tledface doctor`");
  }
  return make_opencl_device(static_cast<std::size_t>(index));
}

}  // namespace tledface
