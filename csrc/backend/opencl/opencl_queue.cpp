#include "backend/opencl/opencl_queue.hpp"

#include <algorithm>
#include <utility>

#include "backend/opencl/loader.hpp"
#include "core/error.hpp"

namespace tledface {
namespace {

// Stages that wait to be used again: displacement and history of two snapshots.
constexpr std::size_t kSpareStages = 4;

std::string one_line(const std::string& text) {
  std::string line;
  for (const char c : text) {
    const bool blank = c == '\0' || c == ' ' || c == '\n' || c == '\r' || c == '\t';
    if (!blank)
      line += c;
    else if (!line.empty() && line.back() != ' ')
      line += ' ';
  }
  while (!line.empty() && line.back() == ' ') line.pop_back();
  return line;
}

template <typename Query, typename Object>
std::string query_text(Query query, Object object, cl::Enum what) {
  std::size_t size = 0;
  if (query(object, what, 0, nullptr, &size) != cl::kSuccess || size == 0) return {};
  std::string text(size, '\0');
  if (query(object, what, size, text.data(), nullptr) != cl::kSuccess) return {};
  return one_line(text);
}

// The compiler's errors, or the log's first lines where it names none; at most four, in one line.
std::string first_errors(const std::string& log) {
  std::string errors, head;
  int n_errors = 0, n_head = 0;
  for (std::size_t start = 0; start < log.size();) {
    const auto end = std::min(log.find('\n', start), log.size());
    const std::string line = one_line(log.substr(start, end - start));
    start = end + 1;
    if (line.empty()) continue;
    if (line.find("error") != std::string::npos && n_errors++ < 4)
      errors += (errors.empty() ? "" : " | ") + line;
    if (n_head++ < 4) head += (head.empty() ? "" : " | ") + line;
  }
  if (!errors.empty()) return errors;
  return head.empty() ? "the compiler left no log" : head;
}

// The entry points of cl_khr_command_buffer; nothing where one is missing, or where its queues must
// have properties that ours lack.
std::optional<cl::CommandBufferApi> find_command_buffers(const cl::Api& api, cl::DeviceId device) {
  const std::string extensions = " " + device_text(api, device, cl::kDeviceExtensions) + " ";
  if (extensions.find(" cl_khr_command_buffer ") == std::string::npos) return std::nullopt;
  cl::Bitfield needed = 0, able = 0;
  if (api.GetDeviceInfo(device, cl::kDeviceCommandBufferRequiredQueue, sizeof needed, &needed,
                        nullptr) != cl::kSuccess ||
      needed != 0)
    return std::nullopt;
  if (api.GetDeviceInfo(device, cl::kDeviceCommandBufferCapabilities, sizeof able, &able,
                        nullptr) != cl::kSuccess)
    able = 0;
  const auto platform = query_value<cl::Platform>(api, device, cl::kDevicePlatform);
  cl::CommandBufferApi found;
  found.simultaneous = able & cl::kCommandBufferCapabilitySimultaneous;
#define TLEDFACE_CL_FIND(name, result, arguments)                        \
  found.name = reinterpret_cast<decltype(found.name)>(                   \
      api.GetExtensionFunctionAddressForPlatform(platform, "cl" #name)); \
  if (!found.name) return std::nullopt;
  TLEDFACE_CL_COMMAND_BUFFER_ENTRY_POINTS(TLEDFACE_CL_FIND)
#undef TLEDFACE_CL_FIND
  return found;
}

}  // namespace

std::string device_text(const cl::Api& api, cl::DeviceId device, cl::Enum what) {
  return query_text(api.GetDeviceInfo, device, what);
}

std::string platform_text(const cl::Api& api, cl::Platform platform, cl::Enum what) {
  return query_text(api.GetPlatformInfo, platform, what);
}

OpenClContext::OpenClContext(const cl::Api& api, cl::DeviceId device) : api(api), device(device) {
  cl::Int status = cl::kSuccess;
  handle = api.CreateContext(nullptr, 1, &device, nullptr, nullptr, &status);
  if (status != cl::kSuccess)
    throw SimulationError("clCreateContext: " + opencl_error_name(status));
  command_buffers = find_command_buffers(api, device);
}

// Never destroyed: see loader().
OpenClContext& OpenClContext::of(const cl::Api& api, cl::DeviceId device) {
  static std::mutex mutex;
  static auto* contexts = new std::map<cl::DeviceId, std::unique_ptr<OpenClContext>>;
  std::lock_guard<std::mutex> lock(mutex);
  auto& context = (*contexts)[device];
  if (!context) context = std::make_unique<OpenClContext>(api, device);
  return *context;
}

cl::ProgramId OpenClContext::program(const std::string& source, const std::string& build_options,
                                     const std::string& device_name) {
  std::lock_guard<std::mutex> lock(mutex_);
  const auto found = programs_.find(source);
  if (found != programs_.end()) return found->second;
  cl::Int status = cl::kSuccess;
  const char* text = source.c_str();
  const std::size_t length = source.size();
  cl::ProgramId built = api.CreateProgramWithSource(handle, 1, &text, &length, &status);
  if (status != cl::kSuccess)
    throw SimulationError(device_name +
                          ": clCreateProgramWithSource: " + opencl_error_name(status));
  status = api.BuildProgram(built, 1, &device, build_options.c_str(), nullptr, nullptr);
  if (status != cl::kSuccess) {
    const std::string log = build_log(built);
    api.ReleaseProgram(built);
    throw SimulationError(device_name + ": kernels do not compile, " + opencl_error_name(status) +
                          ": " + first_errors(log));
  }
  programs_.emplace(source, built);
  return built;
}

std::string OpenClContext::build_log(cl::ProgramId program_id) const {
  std::size_t size = 0;
  if (api.GetProgramBuildInfo(program_id, device, cl::kProgramBuildLog, 0, nullptr, &size) !=
          cl::kSuccess ||
      size == 0)
    return {};
  std::string log(size, '\0');
  api.GetProgramBuildInfo(program_id, device, cl::kProgramBuildLog, size, log.data(), nullptr);
  return log;
}

OpenClQueue::OpenClQueue(OpenClContext& context, DeviceInfo info)
    : api(context.api), context(context), info(std::move(info)) {
  cl::Int status = cl::kSuccess;
  handle = api.CreateCommandQueue(context.handle, context.device, 0, &status);
  check(status, "clCreateCommandQueue");
}

OpenClQueue::~OpenClQueue() {
  api.Finish(handle);
  if (transfers_) {
    api.Finish(transfers_);
    for (OpenClStage& stage : spare_) release(stage);
    api.ReleaseCommandQueue(transfers_);
  }
  api.ReleaseCommandQueue(handle);
}

void OpenClQueue::check(cl::Int status, const std::string& call) const {
  if (status != cl::kSuccess)
    throw SimulationError(name() + ": " + call + ": " + opencl_error_name(status));
}

cl::Queue OpenClQueue::transfers() {
  std::lock_guard<std::mutex> lock(mutex_);
  if (!transfers_) {
    cl::Int status = cl::kSuccess;
    transfers_ = api.CreateCommandQueue(context.handle, context.device, 0, &status);
    check(status, "clCreateCommandQueue");
  }
  return transfers_;
}

OpenClStage OpenClQueue::take_stage(std::size_t bytes) {
  const cl::Queue transfers = this->transfers();
  {
    std::lock_guard<std::mutex> lock(mutex_);
    const auto found = std::find_if(spare_.begin(), spare_.end(),
                                    [&](const OpenClStage& stage) { return stage.bytes == bytes; });
    if (found != spare_.end()) {
      OpenClStage stage = std::move(*found);
      spare_.erase(found);
      return stage;
    }
  }
  OpenClStage stage;
  stage.bytes = bytes;
  cl::Int status = cl::kSuccess;
  stage.on_device = api.CreateBuffer(context.handle, cl::kMemoryReadWrite, bytes, nullptr, &status);
  check(status, "clCreateBuffer");
  // Memory that the driver has pinned: to any other, some drivers copy while the host waits.
  stage.pinned = api.CreateBuffer(context.handle, cl::kMemoryReadWrite | cl::kMemoryAllocateOnHost,
                                  bytes, nullptr, &status);
  // The queue maps it before it reads into it; to wait here is to wait for readings under way.
  if (status == cl::kSuccess)
    stage.on_host =
        api.EnqueueMapBuffer(transfers, stage.pinned, cl::kFalse, cl::kMapRead | cl::kMapWrite, 0,
                             bytes, 0, nullptr, nullptr, &status);
  if (status != cl::kSuccess || !stage.on_host) {
    if (stage.pinned) api.ReleaseMemObject(stage.pinned);
    stage.pinned = nullptr;
    stage.pageable.resize(bytes);
    stage.on_host = stage.pageable.data();
  }
  return stage;
}

void OpenClQueue::give_back(OpenClStage stage) {
  std::lock_guard<std::mutex> lock(mutex_);
  if (spare_.size() >= kSpareStages) {
    release(spare_.front());
    spare_.erase(spare_.begin());
  }
  spare_.push_back(std::move(stage));
}

void OpenClQueue::release(OpenClStage& stage) {
  if (stage.pinned) {
    api.EnqueueUnmapMemObject(transfers_, stage.pinned, stage.on_host, 0, nullptr, nullptr);
    api.Finish(transfers_);
    api.ReleaseMemObject(stage.pinned);
  }
  api.ReleaseMemObject(stage.on_device);
}

}  // namespace tledface
