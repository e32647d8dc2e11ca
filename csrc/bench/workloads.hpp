// The bodies that the benchmark steps, made without files or Python: a flat block, a face-sized
// shell that slides, a small figure, and the block and the shell that no cache holds.
#pragma once
#include <cstddef>
#include <string>
#include <vector>

#include "precompute/voxel_model.hpp"
#include "sim/sliding.hpp"

namespace tledface::bench {

struct Workload {
  std::string name;
  VoxelModel model;
  SlidingNodes sliding;
  double speed = 0;       // m a step along y, at which the body is thrown
  double activation = 0;  // of all muscles, once contracted

  std::size_t n_muscle_elements() const {
    std::size_t count = 0;
    for (const VoxelMuscle& muscle : model.muscles) count += muscle.elements.size();
    return count;
  }
};

// Names, the quick ones first.
const std::vector<std::string>& workload_names();
// The workload's own number of elements; where it is this large, a measurement takes minutes.
std::size_t workload_elements(const std::string& name);

// flat-block: 120 x 120 x 9, the demo's. face: 325 x 325 columns of 4.76 voxels on a bone, the
// paper's forehead. armadillo: a figure under gravity. dense-block, slab: the flat block's layers
// on deep and on 16 voxels thick tissue. sparse-shell: a vault of columns of five voxels, its rim
// held. elements: about how many instead of the workload's own, of the same thickness; 0: its own.
// Throws InputError for another name.
Workload make_workload(const std::string& name, std::size_t elements = 0);

}  // namespace tledface::bench
