// Shared row sets, laws, masses and muscles of placed elements and nodes: see solver_arrays.hpp and
// kernels_cl/layout.cl.
#include "precompute/solver_arrays.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "core/error.hpp"
#include "core/threads.hpp"
#include "precompute/law_entries.hpp"
#include "precompute/law_table.hpp"
#include "precompute/layout.hpp"
#include "precompute/placement.hpp"
#include "precompute/row_sets.hpp"

namespace tledface {
namespace {

void check(const VoxelModel& model) {
  const std::size_t n = model.n_elements();
  if (n == 0) throw InputError("model: it has no element; nothing can be simulated");
  if (model.mu.size() != n || model.bulk_log.size() != n || model.bulk_quadratic.size() != n ||
      model.density.size() != n || model.shear_modulus.size() != n ||
      model.bulk_modulus.size() != n || model.bending_modulus.size() != 3 * n ||
      model.fixed.size() != 3 * model.n_nodes())
    throw InputError("model: arrays of elements or nodes differ in length");
  for (std::size_t e = 0; e < n; ++e)
    if (!(model.shear_modulus[e] > 0) || !(model.bulk_modulus[e] > 0) || !(model.density[e] > 0))
      throw InputError("model: element " + std::to_string(e) +
                       " has a shear modulus, bulk modulus or density that is not positive");
}

}  // namespace

SolverArrays make_solver_arrays(const VoxelModel& model, const PrecomputeOptions& options) {
  check(model);
  SolverArrays arrays;
  const int lanes = arrays.lanes = options.lanes;
  arrays.width = options.width;
  if (model.conforming())
    place_hexahedra(model, arrays);
  else
    place_voxels(model, options, arrays);
  const auto order = arrays.order;
  const std::int32_t n_blocks = arrays.n_blocks;
  const std::size_t n_elements = model.n_elements(), n_nodes = model.n_nodes();

  // Elements of each block, in lane order.
  std::vector<std::int64_t> element_at(std::size_t(n_blocks) * lanes, -1);
  for (std::size_t e = 0; e < n_elements; ++e) {
    std::int64_t& at = element_at[arrays.element_slot[e]];
    if (at >= 0)
      throw InputError("model: elements " + std::to_string(at) + " and " + std::to_string(e) +
                       " are the same voxel");
    at = static_cast<std::int64_t>(e);
  }
  RowSets materials(std::size_t(TLED_MATERIAL_ROWS) * lanes, arrays.materials);
  std::vector<double> set(std::size_t(TLED_MATERIAL_ROWS) * lanes);
  double inverse_squares = 0;  // sum 1/h^2 of a voxel
  for (const double side : model.voxel) inverse_squares += 1 / (side * side);
  for (std::int32_t b = 0; b < n_blocks; ++b) {
    std::int32_t* links = &arrays.blocks[std::size_t(b) * TLED_BLOCK_INTS];
    std::uint32_t elements = 0;
    std::fill(set.begin(), set.end(), 0.0);
    for (int lane = 0; lane < lanes; ++lane) {
      const std::int64_t e = element_at[std::size_t(b) * lanes + lane];
      if (e < 0) continue;
      elements |= 1u << ELEMENT_BIT(lane);
      const double mu = model.shear_modulus[e], bulk = model.bulk_modulus[e];
      const double nu = (3 * bulk - 2 * mu) / (2 * (3 * bulk + mu));
      const double youngs_modulus = 9 * bulk * mu / (3 * bulk + mu);
      const double volume = model.element_volume(e);
      const auto put = [&](int row, double value) { set[std::size_t(row) * lanes + lane] = value; };
      put(MATERIAL_PRESENT, 1);
      put(MATERIAL_MU, model.mu[e]);
      put(MATERIAL_BULK_LOG_HALF, model.bulk_log[e] / 2);
      put(MATERIAL_BULK_QUADRATIC, model.bulk_quadratic[e]);
      if (options.hourglass == HourglassForm::kPhysical) {
        put(MATERIAL_NU, nu);
        for (int axis = 0; axis < 3; ++axis)
          put(MATERIAL_BEND_X + axis,
              volume / 3 * model.bending_modulus[3 * e + order[axis]] / (1 - nu * nu));
        put(MATERIAL_TWIST, volume / 3 * mu);
        put(MATERIAL_XYZ, volume / 9 * youngs_modulus);
      } else {
        // k = kappa (lambda + 2 mu) V/16 sum 1/h^2
        const double modulus = bulk + 4 * mu / 3;
        put(MATERIAL_KAPPA, model.conforming()
                                ? kappa_stiffness(model.hexahedra[e], options.kappa, modulus)
                                : options.kappa * volume / 16 * inverse_squares * modulus);
      }
    }
    if (!elements) continue;
    links[BLOCK_MATERIAL] = materials.add(set);
    links[BLOCK_LEVELS] = static_cast<std::int32_t>(elements);
    ++arrays.n_element_blocks;
  }

  add_laws(model, arrays);

  // Masses and fixed components.
  arrays.node_mass.assign(n_nodes, 0);
  std::vector<double> slot_mass(std::size_t(n_blocks + 1) * lanes, 0.0);
  for (std::size_t e = 0; e < n_elements; ++e) {
    const double share = model.density[e] * model.element_volume(e) / 8;
    for (int corner = 0; corner < 8; ++corner) slot_mass[arrays.corner_slot(e, corner)] += share;
  }
  std::vector<double> inverse(std::size_t(n_blocks) * TLED_NODE_ROWS * lanes, 0.0);
  for (std::size_t n = 0; n < n_nodes; ++n) {
    const std::int64_t slot = arrays.node_slot[n], block = slot / lanes, lane = slot % lanes;
    const double mass = arrays.node_mass[n] = slot_mass[slot];
    if (!(mass > 0))
      throw InputError("model: node " + std::to_string(n) + " belongs to no element");
    for (int c = 0; c < 3; ++c)
      if (!model.fixed[3 * n + order[c]])
        inverse[(block * TLED_NODE_ROWS + c) * lanes + lane] = 1 / mass;
  }
  RowSets node_sets(std::size_t(TLED_NODE_ROWS) * lanes, arrays.node_sets);
  std::vector<double> node_set(std::size_t(TLED_NODE_ROWS) * lanes);
  for (std::int32_t b = 0; b < n_blocks; ++b) {
    const auto begin = inverse.begin() + std::ptrdiff_t(b) * TLED_NODE_ROWS * lanes;
    std::copy(begin, begin + TLED_NODE_ROWS * lanes, node_set.begin());
    arrays.blocks[std::size_t(b) * TLED_BLOCK_INTS + BLOCK_NODE] = node_sets.add(node_set);
  }

  // Muscles: per block and muscle one row set.
  struct Fibre {
    std::int64_t slot;
    std::int32_t muscle;
    std::int64_t at;
  };
  std::vector<Fibre> fibres;
  for (std::size_t m = 0; m < model.muscles.size(); ++m) {
    const VoxelMuscle& muscle = model.muscles[m];
    for (std::size_t i = 0; i < muscle.elements.size(); ++i) {
      const std::int64_t e = muscle.elements[i];
      if (e < 0 || e >= static_cast<std::int64_t>(n_elements))
        throw InputError("muscle '" + muscle.name + "': element " + std::to_string(e) +
                         " does not exist");
      fibres.push_back(
          {arrays.element_slot[e], static_cast<std::int32_t>(m), static_cast<std::int64_t>(i)});
    }
    const double lo = muscle.lambda_opt, at_line = std::exp(6.6 * (muscle.lambda_pas - 1));
    const double line =
        muscle.printed_passive ? -2.47 : 0.05 * (at_line - 1) - 2.18 * muscle.lambda_pas;
    const double constants[TLED_MUSCLE_CONSTANTS] = {
        muscle.sigma_act,           -25 / (4 * lo * lo), 25 / (2 * lo),
        muscle.sigma_pas,           muscle.lambda_pas,   line,
        muscle.calcium ? 1.0 : 0.0, muscle.beta};
    arrays.muscle_constants.insert(arrays.muscle_constants.end(), std::begin(constants),
                                   std::end(constants));
  }
  std::sort(fibres.begin(), fibres.end(), [&](const Fibre& a, const Fibre& b) {
    const std::int64_t block_a = a.slot / lanes, block_b = b.slot / lanes;
    if (block_a != block_b) return block_a < block_b;
    if (a.muscle != b.muscle) return a.muscle < b.muscle;
    return a.slot < b.slot;
  });
  RowSets muscle_sets(std::size_t(TLED_MUSCLE_ROWS) * lanes, arrays.muscle_sets);
  std::vector<double> muscle_set(std::size_t(TLED_MUSCLE_ROWS) * lanes);
  for (std::size_t i = 0; i < fibres.size();) {
    const std::int64_t block = fibres[i].slot / lanes;
    std::int32_t* links = &arrays.blocks[block * TLED_BLOCK_INTS];
    links[BLOCK_MUSCLE_BEGIN] = static_cast<std::int32_t>(arrays.muscle_entries.size() / 2);
    while (i < fibres.size() && fibres[i].slot / lanes == block) {
      const std::int32_t muscle = fibres[i].muscle;
      std::fill(muscle_set.begin(), muscle_set.end(), 0.0);
      for (; i < fibres.size() && fibres[i].slot / lanes == block && fibres[i].muscle == muscle;
           ++i) {
        const VoxelMuscle& source = model.muscles[muscle];
        const std::int64_t lane = fibres[i].slot % lanes;
        for (int c = 0; c < 3; ++c)
          muscle_set[c * lanes + lane] = source.fibre[3 * fibres[i].at + order[c]];
        muscle_set[3 * lanes + lane] = source.weight[fibres[i].at];
      }
      arrays.muscle_entries.push_back(muscle);
      arrays.muscle_entries.push_back(muscle_sets.add(muscle_set));
    }
    links[BLOCK_MUSCLE_END] = static_cast<std::int32_t>(arrays.muscle_entries.size() / 2);
  }

  return arrays;
}

std::int64_t SolverArrays::corner_slot(std::size_t element, int corner) const {
  if (!corner_slots.empty()) return corner_slots[8 * element + corner];
  std::int64_t block = element_slot[element] / lanes, lane = element_slot[element] % lanes;
  if ((corner & 2) && (lane += width) >= lanes) {
    block = blocks[block * TLED_BLOCK_INTS + BLOCK_NEXT_Y];
    lane -= lanes;
  }
  if (corner & 4) block = blocks[block * TLED_BLOCK_INTS + BLOCK_NEXT_Z];
  if ((corner & 1) && ++lane % width == 0) {
    block = blocks[block * TLED_BLOCK_INTS + BLOCK_NEXT_X];
    lane -= width;
  }
  return block * lanes + lane;
}

std::vector<double> history_in_layout(const VoxelModel& model, const SolverArrays& from,
                                      const std::vector<double>& rows, const SolverArrays& to) {
  std::vector<double> result(std::size_t(to.n_history_rows) * to.lanes, 0.0);
  for (std::size_t spec = 0; spec < model.laws.size(); ++spec) {
    const int history = law_info(law_number(model.laws[spec].name)).history;
    for (std::size_t i = 0; i < to.history_slot[spec].size(); ++i)
      for (int row = 0; row < history; ++row)
        result[to.history_slot[spec][i] + std::int64_t(row) * to.lanes] =
            rows[from.history_slot[spec][i] + std::int64_t(row) * from.lanes];
  }
  return result;
}

std::vector<double> slots_to_nodes(const SolverArrays& arrays, const std::vector<double>& slots) {
  const std::size_t n = arrays.node_slot.size(), lanes = arrays.lanes;
  std::vector<double> nodes(3 * n);
  parallel_for_chunks(n, 16384, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const std::size_t slot = arrays.node_slot[i], block = slot / lanes, lane = slot % lanes;
      for (int c = 0; c < 3; ++c)
        nodes[3 * i + arrays.order[c]] = slots[(block * 3 + c) * lanes + lane];
    }
  });
  return nodes;
}

std::vector<double> nodes_to_slots(const SolverArrays& arrays, const std::vector<double>& nodes) {
  const std::size_t n = arrays.node_slot.size(), lanes = arrays.lanes;
  if (nodes.size() != 3 * n)
    throw InputError("nodal array: " + std::to_string(3 * n) + " values are needed, got " +
                     std::to_string(nodes.size()));
  std::vector<double> slots(std::size_t(arrays.n_blocks + 1) * lanes * 3, 0.0);
  parallel_for_chunks(n, 16384, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const std::size_t slot = arrays.node_slot[i], block = slot / lanes, lane = slot % lanes;
      for (int c = 0; c < 3; ++c)
        slots[(block * 3 + c) * lanes + lane] = nodes[3 * i + arrays.order[c]];
    }
  });
  return slots;
}

double SolverArrays::fill() const {
  return static_cast<double>(element_slot.size()) / static_cast<double>(n_element_blocks * lanes);
}

}  // namespace tledface
