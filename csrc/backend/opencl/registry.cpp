#include "backend/opencl/registry.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <mutex>

#include "backend/opencl/loader.hpp"
#include "backend/opencl/opencl_device.hpp"
#include "backend/opencl/sources.hpp"
#include "core/error.hpp"

namespace tledface {
namespace {

constexpr int kProbeRows = 37;
constexpr int kProbeWidth = 16;

// Runs probe.cl; what is wrong with its numbers, or nothing.
template <typename Real>
std::string wrong_numbers(OpenClDevice& device, Precision precision, double tolerance) {
  ProgramOptions options;
  options.precision = precision;
  std::vector<Real> values(kProbeRows * kProbeWidth), result(values.size());
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = Real(0.25) + Real(i) / Real(64);
  const std::size_t bytes = values.size() * sizeof(Real);
  const auto input = device.allocate(bytes);
  const auto output = device.allocate(bytes);
  input->write(values.data(), bytes);
  const auto program = device.build_source(shipped_kernel_source("probe.cl", options), options);
  const auto kernel = program->kernel("probe");
  kernel->set_arg(0, *input);
  kernel->set_arg(1, *output);
  kernel->set_arg(2, kProbeRows);
  kernel->enqueue(kProbeRows);
  output->read(result.data(), bytes);
  for (std::size_t i = 0; i < values.size(); ++i) {
    const std::size_t row = i / kProbeWidth * kProbeWidth;
    const double next = values[row + (i - row + 1) % kProbeWidth];
    const double expected = 2.0 * values[i] + 3.0 * next;
    if (std::abs(result[i] - expected) <= tolerance * expected) continue;  // false for a NaN
    char text[128];
    std::snprintf(text, sizeof text, "the probe kernel computes wrong numbers (%.9g for %.9g, %s)",
                  double(result[i]), expected, sizeof(Real) == 8 ? "double" : "single");
    return text;
  }
  return {};
}

// Whether launches that are recorded and replayed give the bits of launches one by one: three that
// read what the one before wrote, twice.
bool records_rightly(OpenClDevice& device) {
  if (!device.offers_command_buffers()) return false;
  ProgramOptions options;
  std::vector<float> values(kProbeRows * kProbeWidth);
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = 0.25f + float(i) / 64;
  const std::size_t bytes = values.size() * sizeof(float);
  const auto program = device.build_source(shipped_kernel_source("probe.cl", options), options);
  const auto kernel = program->kernel("probe");
  const auto first = device.allocate(bytes), second = device.allocate(bytes);
  const auto launches = [&] {
    for (const int n_rows : {kProbeRows, kProbeRows - 1, kProbeRows - 2}) {
      const bool forth = n_rows % 2 == kProbeRows % 2;
      kernel->set_arg(0, forth ? *first : *second);
      kernel->set_arg(1, forth ? *second : *first);
      kernel->set_arg(2, n_rows);
      kernel->enqueue(kProbeRows);
    }
  };
  std::vector<float> expected(values.size()), got(values.size());
  for (auto* result : {&expected, &got}) {
    first->write(values.data(), bytes);
    second->write(values.data(), bytes);
    std::unique_ptr<Recording> recording;
    if (result == &got && !(recording = device.record(launches))) return false;
    for (int twice = 0; twice < 2; ++twice) recording ? recording->replay() : launches();
    second->read(result->data(), bytes);
  }
  return std::memcmp(expected.data(), got.data(), bytes) == 0;
}

class Registry {
 public:
  Registry() : api_(opencl_api()) {
    if (!api_) return;
    for (const auto platform : opencl_platforms()) {
      cl::UInt count = 0;
      if (api_->GetDeviceIDs(platform, cl::kDeviceTypeAll, 0, nullptr, &count) != cl::kSuccess)
        continue;  // CL_DEVICE_NOT_FOUND: a driver without its hardware
      std::vector<cl::DeviceId> handles(count);
      if (api_->GetDeviceIDs(platform, cl::kDeviceTypeAll, count, handles.data(), nullptr) !=
          cl::kSuccess)
        continue;
      for (const auto handle : handles) {
        // A driver registered twice hands out the same devices twice.
        if (find(handle) < entries_.size()) continue;
        Entry entry{handle, describe_opencl_device(*api_, platform, handle), false};
        entry.info.id = "opencl:" + std::to_string(entries_.size());
        entry.probed = !entry.info.reason.empty();
        entries_.push_back(std::move(entry));
      }
    }
  }

  std::vector<DeviceInfo> list() {
    std::lock_guard<std::mutex> lock(mutex_);
    std::vector<DeviceInfo> infos;
    for (const auto& entry : entries_) infos.push_back(entry.info);
    return infos;
  }

  DeviceInfo probe(std::size_t index) {
    std::lock_guard<std::mutex> lock(mutex_);
    Entry& entry = entries_.at(index);
    if (!entry.probed) {
      entry.info.reason = run_probe(entry);
      entry.info.works = entry.info.reason.empty();
      entry.info.command_buffers = entry.info.works && try_recording(entry);
      entry.probed = true;
    }
    return entry.info;
  }

  std::shared_ptr<Device> open(std::size_t index) {
    const DeviceInfo info = probe(index);
    if (!info.works)
      throw InputError("device '" + info.id + "' (" + info.name + "): does not work: " +
                       info.reason + "; choose another, see `tledface doctor`");
    return std::make_shared<OpenClDevice>(*api_, entries_[index].handle, info);
  }

  // Number of entries where the handle is not listed.
  std::size_t find(cl::DeviceId handle) const {
    const auto found = std::find_if(entries_.begin(), entries_.end(),
                                    [&](const Entry& entry) { return entry.handle == handle; });
    return static_cast<std::size_t>(found - entries_.begin());
  }

  std::size_t size() const { return entries_.size(); }

 private:
  struct Entry {
    cl::DeviceId handle;
    DeviceInfo info;
    bool probed;
  };

  std::string run_probe(const Entry& entry) {
    try {
      OpenClDevice device(*api_, entry.handle, entry.info);
      const std::string wrong = wrong_numbers<float>(device, Precision::kSingle, 2e-6);
      if (!wrong.empty() || !entry.info.has_double) return wrong;
      return wrong_numbers<double>(device, Precision::kDouble, 1e-14);
    } catch (const std::exception& error) {
      const std::string prefix = "device '" + entry.info.id + "': ";
      const std::string text = error.what();
      return text.rfind(prefix, 0) == 0 ? text.substr(prefix.size()) : text;
    }
  }

  bool try_recording(const Entry& entry) {
    try {
      DeviceInfo info = entry.info;
      info.command_buffers = true;
      OpenClDevice device(*api_, entry.handle, info);
      return records_rightly(device);
    } catch (const std::exception&) {
      return false;
    }
  }

  const cl::Api* api_;
  std::mutex mutex_;
  std::vector<Entry> entries_;
};

Registry& registry() {
  static Registry* instance = new Registry;
  return *instance;
}

}  // namespace

std::vector<DeviceInfo> list_opencl_devices() { return registry().list(); }

DeviceInfo probe_opencl_device(std::size_t index) { return registry().probe(index); }

std::vector<DeviceInfo> opencl_devices() {
  for (std::size_t index = 0; index < registry().size(); ++index) registry().probe(index);
  return registry().list();
}

std::shared_ptr<Device> make_opencl_device(std::size_t index) {
  if (index >= registry().size())
    throw InputError("device 'opencl:" + std::to_string(index) + "': no such device; there are " +
                     std::to_string(registry().size()) + " OpenCL devices, see `tledface doctor`");
  return registry().open(index);
}

std::shared_ptr<Device> make_opencl_device_from_handle(std::uintptr_t handle) {
  const std::size_t index = registry().find(reinterpret_cast<cl::DeviceId>(handle));
  if (index == registry().size())
    throw InputError("device: the OpenCL device given is none that tledface's OpenCL library (" +
                     opencl_loader_report() +
                     ") lists; it comes from another library: import pyopencl before tledface "
                     "opens a device, or point TLEDFACE_OPENCL_LIBRARY at pyopencl's");
  return registry().open(index);
}

}  // namespace tledface
