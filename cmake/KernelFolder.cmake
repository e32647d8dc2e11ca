# The kernel folder of the build: links to kernels_cl/ and the generated laws.cl, which lists every
# material/*.cl, so that a new constitutive law is one new file there. Installed as it is.
set(kernel_source ${CMAKE_CURRENT_SOURCE_DIR}/kernels_cl)
set(TLEDFACE_KERNEL_FOLDER ${CMAKE_CURRENT_BINARY_DIR}/kernels_cl)
file(MAKE_DIRECTORY ${TLEDFACE_KERNEL_FOLDER})
foreach(part material muscle)
  file(CREATE_LINK ${kernel_source}/${part} ${TLEDFACE_KERNEL_FOLDER}/${part} SYMBOLIC)
endforeach()
file(GLOB kernel_files RELATIVE ${kernel_source} CONFIGURE_DEPENDS ${kernel_source}/*.cl)
foreach(file ${kernel_files})
  file(CREATE_LINK ${kernel_source}/${file} ${TLEDFACE_KERNEL_FOLDER}/${file} SYMBOLIC)
endforeach()

# Laws with `stage = 1` change the stress of those before them and come last.
file(GLOB law_files RELATIVE ${kernel_source} CONFIGURE_DEPENDS ${kernel_source}/material/*.cl)
list(SORT law_files)
set(includes "")
set(stress_cases "")
set(energy_cases "")
set(table "")
set(id 0)
foreach(stage 0 1)
  foreach(file ${law_files})
    get_filename_component(law ${file} NAME_WE)
    file(STRINGS ${kernel_source}/${file} header REGEX "^(stage|rows|history|vectors) = ")
    set_property(DIRECTORY APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${kernel_source}/${file})
    string(REGEX MATCH "stage = ([0-9]+)" _ "${header}")
    set(law_stage ${CMAKE_MATCH_1})
    string(REGEX MATCH "rows = ([0-9]+)" _ "${header}")
    set(law_rows ${CMAKE_MATCH_1})
    string(REGEX MATCH "history = ([0-9]+)" _ "${header}")
    set(law_history ${CMAKE_MATCH_1})
    string(REGEX MATCH "vectors = .([0-9, ]*)" _ "${header}")
    set(law_vectors ${CMAKE_MATCH_1})
    if("${law_stage}" STREQUAL "" OR "${law_rows}" STREQUAL "" OR "${law_history}" STREQUAL "")
      message(FATAL_ERROR "${file}: its header needs lines 'stage = n', 'rows = n', 'history = n'")
    endif()
    if(NOT law_stage EQUAL stage)
      continue()
    endif()
    string(APPEND includes "#include \"${file}\"\n")
    string(APPEND stress_cases
      "    case ${id}: ${law}_stress(k, rows, state, P); break;\n")
    string(APPEND energy_cases "    case ${id}: return ${law}_energy(k, rows, state);\n")
    string(APPEND table "    {\"${law}\", ${law_rows}, ${law_history}, {${law_vectors}}},\n")
    math(EXPR id "${id} + 1")
  endforeach()
endforeach()
set(generated "// Made from material/*.cl by cmake/KernelFolder.cmake: do not edit.
${includes}
INLINE void add_law_stress(int law, Kinematics k, __global const real* rows, LawState state,
                           Tensor* P) {
  switch (law) {
${stress_cases}  }
}

INLINE realv law_energy(int law, Kinematics k, __global const real* rows, LawState state) {
  switch (law) {
${energy_cases}  }
  return broadcast(R(0.0));
}
")
file(CONFIGURE OUTPUT ${TLEDFACE_KERNEL_FOLDER}/laws.cl CONTENT "${generated}" @ONLY)
file(CONFIGURE OUTPUT ${CMAKE_CURRENT_BINARY_DIR}/generated/precompute/law_table.inc
     CONTENT "${table}" @ONLY)
