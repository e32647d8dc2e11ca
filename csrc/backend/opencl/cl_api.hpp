// The part of the OpenCL 1.2 interface that tledface calls, and of cl_khr_command_buffer: types,
// constants and entry points as the Khronos specification defines them. OpenCL is found at run
// time, so nothing links to it.
#pragma once
#include <cstddef>
#include <cstdint>

namespace tledface::cl {

using Int = std::int32_t;
using UInt = std::uint32_t;
using Bool = UInt;
using Bitfield = std::uint64_t;
using Enum = UInt;  // cl_platform_info, cl_device_info, …

using Platform = struct PlatformObject*;
using DeviceId = struct DeviceObject*;
using Context = struct ContextObject*;
using Queue = struct QueueObject*;
using Memory = struct MemoryObject*;
using ProgramId = struct ProgramObject*;
using KernelId = struct KernelObject*;
using Event = struct EventObject*;
using CommandBuffer = struct CommandBufferObject*;

constexpr Int kSuccess = 0;
constexpr Int kMemoryAllocationFailure = -4;
constexpr Int kOutOfResources = -5;
constexpr Int kOutOfHostMemory = -6;
constexpr Int kInvalidBufferSize = -61;

constexpr Bool kFalse = 0, kTrue = 1;

constexpr Bitfield kDeviceTypeCpu = 1u << 1;
constexpr Bitfield kDeviceTypeGpu = 1u << 2;
constexpr Bitfield kDeviceTypeAll = 0xFFFFFFFFu;
constexpr Bitfield kMemoryReadWrite = 1u << 0;
constexpr Bitfield kMemoryUseHostPointer = 1u << 3;
constexpr Bitfield kMemoryAllocateOnHost = 1u << 4;
constexpr Bitfield kMapRead = 1u << 0, kMapWrite = 1u << 1;

constexpr Enum kPlatformVersion = 0x0901;
constexpr Enum kPlatformName = 0x0902;
constexpr Enum kPlatformVendor = 0x0903;

constexpr Enum kDeviceType = 0x1000;
constexpr Enum kDeviceMaxComputeUnits = 0x1002;
constexpr Enum kDeviceMaxMemoryAllocation = 0x1010;
constexpr Enum kDeviceGlobalMemorySize = 0x101F;
constexpr Enum kDeviceLocalMemorySize = 0x1023;
constexpr Enum kDeviceAvailable = 0x1027;
constexpr Enum kDeviceCompilerAvailable = 0x1028;
constexpr Enum kDeviceName = 0x102B;
constexpr Enum kDriverVersion = 0x102D;
constexpr Enum kDeviceExtensions = 0x1030;
constexpr Enum kDevicePlatform = 0x1031;
constexpr Enum kDeviceDoubleConfig = 0x1032;
constexpr Enum kDeviceNativeVectorWidthFloat = 0x103A;

constexpr Enum kDeviceCommandBufferCapabilities = 0x12A9;
constexpr Enum kDeviceCommandBufferRequiredQueue = 0x12AA;
constexpr Bitfield kCommandBufferCapabilitySimultaneous = 1u << 2;
constexpr std::uint64_t kCommandBufferFlags = 0x1293, kCommandBufferSimultaneousUse = 1u << 0;

constexpr Enum kProgramBuildLog = 0x1183;
constexpr Enum kKernelWorkGroupSize = 0x11B0;

// X(name without "cl", return type, argument types)
#define TLEDFACE_CL_ENTRY_POINTS(X)                                                              \
  X(GetPlatformIDs, Int, (UInt, Platform*, UInt*))                                               \
  X(GetPlatformInfo, Int, (Platform, Enum, std::size_t, void*, std::size_t*))                    \
  X(GetDeviceIDs, Int, (Platform, Bitfield, UInt, DeviceId*, UInt*))                             \
  X(GetDeviceInfo, Int, (DeviceId, Enum, std::size_t, void*, std::size_t*))                      \
  X(CreateContext, Context,                                                                      \
    (const std::intptr_t*, UInt, const DeviceId*,                                                \
     void (*)(const char*, const void*, std::size_t, void*), void*, Int*))                       \
  X(ReleaseContext, Int, (Context))                                                              \
  X(CreateCommandQueue, Queue, (Context, DeviceId, Bitfield, Int*))                              \
  X(ReleaseCommandQueue, Int, (Queue))                                                           \
  X(CreateBuffer, Memory, (Context, Bitfield, std::size_t, void*, Int*))                         \
  X(ReleaseMemObject, Int, (Memory))                                                             \
  X(SetMemObjectDestructorCallback, Int, (Memory, void (*)(Memory, void*), void*))               \
  X(EnqueueReadBuffer, Int,                                                                      \
    (Queue, Memory, Bool, std::size_t, std::size_t, void*, UInt, const Event*, Event*))          \
  X(EnqueueWriteBuffer, Int,                                                                     \
    (Queue, Memory, Bool, std::size_t, std::size_t, const void*, UInt, const Event*, Event*))    \
  X(EnqueueCopyBuffer, Int,                                                                      \
    (Queue, Memory, Memory, std::size_t, std::size_t, std::size_t, UInt, const Event*, Event*))  \
  X(EnqueueMapBuffer, void*,                                                                     \
    (Queue, Memory, Bool, Bitfield, std::size_t, std::size_t, UInt, const Event*, Event*, Int*)) \
  X(EnqueueUnmapMemObject, Int, (Queue, Memory, void*, UInt, const Event*, Event*))              \
  X(WaitForEvents, Int, (UInt, const Event*))                                                    \
  X(ReleaseEvent, Int, (Event))                                                                  \
  X(EnqueueFillBuffer, Int,                                                                      \
    (Queue, Memory, const void*, std::size_t, std::size_t, std::size_t, UInt, const Event*,      \
     Event*))                                                                                    \
  X(CreateProgramWithSource, ProgramId, (Context, UInt, const char**, const std::size_t*, Int*)) \
  X(BuildProgram, Int,                                                                           \
    (ProgramId, UInt, const DeviceId*, const char*, void (*)(ProgramId, void*), void*))          \
  X(GetProgramBuildInfo, Int, (ProgramId, DeviceId, Enum, std::size_t, void*, std::size_t*))     \
  X(ReleaseProgram, Int, (ProgramId))                                                            \
  X(CreateKernel, KernelId, (ProgramId, const char*, Int*))                                      \
  X(ReleaseKernel, Int, (KernelId))                                                              \
  X(SetKernelArg, Int, (KernelId, UInt, std::size_t, const void*))                               \
  X(GetKernelWorkGroupInfo, Int, (KernelId, DeviceId, Enum, std::size_t, void*, std::size_t*))   \
  X(EnqueueNDRangeKernel, Int,                                                                   \
    (Queue, KernelId, UInt, const std::size_t*, const std::size_t*, const std::size_t*, UInt,    \
     const Event*, Event*))                                                                      \
  X(GetExtensionFunctionAddressForPlatform, void*, (Platform, const char*))                      \
  X(Flush, Int, (Queue))                                                                         \
  X(Finish, Int, (Queue))

// Entry points of one loaded library; all are set. Driver objects carry their own dispatch table
// (cl_khr_icd), so the entry points of one loader also serve objects that another one handed out.
struct Api {
#define TLEDFACE_CL_DECLARE(name, result, arguments) result(*name) arguments = nullptr;
  TLEDFACE_CL_ENTRY_POINTS(TLEDFACE_CL_DECLARE)
#undef TLEDFACE_CL_DECLARE
};

// What cl_khr_command_buffer has that all its versions (0.9.0 and later) call alike. The fourth
// argument of a recorded launch is the kernel; sync points and handles of commands are not used.
#define TLEDFACE_CL_COMMAND_BUFFER_ENTRY_POINTS(X)                                           \
  X(CreateCommandBufferKHR, CommandBuffer, (UInt, const Queue*, const std::uint64_t*, Int*)) \
  X(FinalizeCommandBufferKHR, Int, (CommandBuffer))                                          \
  X(ReleaseCommandBufferKHR, Int, (CommandBuffer))                                           \
  X(EnqueueCommandBufferKHR, Int, (UInt, Queue*, CommandBuffer, UInt, const Event*, Event*)) \
  X(CommandNDRangeKernelKHR, Int,                                                            \
    (CommandBuffer, Queue, const std::uint64_t*, KernelId, UInt, const std::size_t*,         \
     const std::size_t*, const std::size_t*, UInt, const UInt*, UInt*, void**))

// Entry points of one platform.
struct CommandBufferApi {
#define TLEDFACE_CL_DECLARE(name, result, arguments) result(*name) arguments = nullptr;
  TLEDFACE_CL_COMMAND_BUFFER_ENTRY_POINTS(TLEDFACE_CL_DECLARE)
#undef TLEDFACE_CL_DECLARE
  bool simultaneous = false;  // one that is still running may be enqueued again
};

}  // namespace tledface::cl
