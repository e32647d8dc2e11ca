# The kernels of kernels_cl/ compiled ahead of time: one object per instruction set and precision.
# -ffp-contract=fast and no trapping are the freedoms OpenCL's -cl-mad-enable gives; nothing that
# reorders sums or forgets NaN.
set(native_flags -O3 -ffp-contract=fast -fno-math-errno -fno-trapping-math -Wno-unknown-pragmas
    -Wno-unused-function -Wno-unused-parameter -Wno-psabi -Wno-ignored-attributes)
# The fused element has more values than any processor has registers: allocation over the whole
# function keeps the right ones (2 % of a step on AVX2).
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  list(APPEND native_flags -fira-region=all)
endif()
# With sanitizers GCC 12 no longer sees that its intrinsics read nothing of the vectors they leave undefined.
# Where variables are kept is left out, and what is gained beyond -O1: every load and every sum has its
# check, so that -O3 takes most of a quarter of an hour a table and -O1 a minute. Rows that count, each
# number of which is an object, take five minutes even so: they are the same text, and go without.
if(TLEDFACE_SANITIZE)
  list(APPEND native_flags -Wno-maybe-uninitialized -g1 -O1)
endif()

function(add_native_kernels table instruction_set lanes is_double)
  set(target native_${table})
  add_library(${target} OBJECT csrc/backend/native/kernel_table.cpp)
  target_include_directories(${target} PRIVATE csrc ${TLEDFACE_KERNEL_FOLDER})
  target_compile_definitions(${target} PRIVATE TLED_TABLE=${table} TLED_LANES=${lanes}
    TLED_DOUBLE=${is_double} TLED_INSTRUCTION_SET="${instruction_set}")
  target_compile_options(${target} PRIVATE ${native_flags} ${ARGN})
  if(table STREQUAL "counted_float")
    target_compile_options(${target} PRIVATE ${tledface_warnings})
  else()
    target_link_libraries(${target} PRIVATE tledface_options)
  endif()
  set_target_properties(${target} PROPERTIES POSITION_INDEPENDENT_CODE ON)
  target_sources(tledface_core PRIVATE $<TARGET_OBJECTS:${target}>)
endfunction()

if(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64")
  # -mtune is fixed: `native` mistakes some virtual machines for chips that split 512-bit vectors.
  set(avx512 -march=x86-64-v4 -mtune=skylake-avx512 -mprefer-vector-width=512)
  set(avx2 -march=x86-64-v3 -mtune=haswell)
  add_native_kernels(avx512_float "AVX-512" 16 0 ${avx512})
  add_native_kernels(avx512_double "AVX-512" 8 1 ${avx512})
  add_native_kernels(avx2_float "AVX2" 8 0 ${avx2})
  add_native_kernels(avx2_double "AVX2" 4 1 ${avx2})
  target_compile_definitions(tledface_core PRIVATE TLEDFACE_X86=1)
endif()
add_native_kernels(portable_float "portable" 8 0)
add_native_kernels(portable_double "portable" 4 1)
# Once more with rows that count, for the benchmark's roofline: speed does not matter.
add_native_kernels(counted_float "counted" 1 0 -O0)
target_compile_definitions(native_counted_float PRIVATE TLED_COUNTED=1)
if(NOT TLEDFACE_PYTHON)  # bench executables run from the build folder; the package says its own
  target_compile_definitions(tledface_core PRIVATE
    TLEDFACE_KERNEL_FOLDER="${TLEDFACE_KERNEL_FOLDER}")
endif()
