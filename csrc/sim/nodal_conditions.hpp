// What acts on single nodes: prescribed displacement, forces, surface pressure. On the device they
// are a few small kernels after each step (kernels_cl/conditions.cl), nothing where there are none;
// on the host the same forces in float64, for residuals, reactions and energies.
#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "backend/device.hpp"
#include "precompute/solver_arrays.hpp"

namespace tledface {

// A degree of freedom is 3 * node + component in the model's order and frame. A channel is a number
// that changes from step to step.
struct Conditions {
  // Prescribed components that share a channel's value, m.
  std::vector<std::int64_t> prescribed_dofs;
  std::vector<std::int32_t> prescribed_channels;
  // Prescribed components with a value each, linear between keys kFieldStride steps apart.
  std::vector<std::int64_t> field_dofs;
  // Forces (N) for a factor of 1 of their channel.
  std::vector<std::int64_t> load_dofs;
  std::vector<std::int32_t> load_channels;
  std::vector<double> load_forces;
  // Boundary faces (nodes, counter-clockwise seen from outside) under a channel's pressure, Pa.
  std::vector<std::int32_t> pressure_faces;  // 4 per face
  std::vector<std::int32_t> pressure_channels;
  std::int32_t n_loads = 0, n_pressures = 0, n_prescribed = 0;  // channels

  // Values a step: factors of the loads, then pressures, then prescribed values.
  std::int32_t n_values() const { return n_loads + n_pressures + n_prescribed; }
};

// Steps between keys of a prescribed field: the error of a motion a(t) is at most
// (8 dt)^2/8 max |a''|, far below a step's own.
constexpr std::int64_t kFieldStride = 8;

// Where a moment lies between the keys that were written: after `key`, by a share of the way to the
// next.
struct FieldMoment {
  std::int64_t key = 0;
  double weight = 0;
};

class NodalConditions {
 public:
  // `first_column`: of the step table, behind the activations. `batch`: most steps of a table.
  NodalConditions(Conditions conditions, const VoxelModel& model, const SolverArrays& arrays,
                  Device& device, Program& program, Precision precision, std::int32_t first_column,
                  std::size_t batch);

  const Conditions& given() const { return given_; }
  // Columns of the step table: the values, and the fields' moment.
  static std::int32_t n_columns(const Conditions& conditions) {
    return conditions.n_values() + (conditions.field_dofs.empty() ? 0 : 2);
  }
  std::size_t bytes() const { return bytes_; }
  // Whether anything here acts on one of these nodes.
  bool any_acts_on(const std::vector<std::int64_t>& nodes) const;

  // `blocks`, `node_sets`: where inverse masses are. u[parity] is the displacement of now.
  void bind(const Buffer* const (&u)[2], const Buffer& blocks, const Buffer& node_sets,
            const Buffer& step_table, std::int32_t step_reals);
  // Columns of one step from its values and the moment of its end.
  void fill_columns(const double* values, FieldMoment field, double* columns) const;
  // Keys of the fields, n_fields() each, in the order of Conditions::field_dofs.
  void write_keys(const double* keys, std::size_t count);
  std::size_t n_fields() const { return given_.field_dofs.size(); }
  // After the kernels of a step from u[parity].
  void enqueue(int parity, std::int32_t step_index);

  // Host: external forces (3 per node, N) under displacement u, without gravity.
  std::vector<double> force(const std::vector<double>& u, const double* values) const;

 private:
  std::unique_ptr<Buffer> reals(const std::vector<double>& values);
  std::unique_ptr<Buffer> integers(const std::vector<std::int32_t>& values);
  std::int32_t dof_index(std::int64_t dof) const;
  void make_loads();
  void make_pressures();

  Conditions given_;
  const VoxelModel& model_;
  const SolverArrays& arrays_;
  Device& device_;
  Precision precision_;
  std::int32_t first_column_;
  double area_sign_;  // -1/8, with the handedness of the solver's axes
  std::size_t bytes_ = 0;
  std::int32_t n_load_dofs_ = 0, n_pressure_nodes_ = 0;
  std::unique_ptr<Kernel> loads_[2], pressure_[2], prescribe_[2], fields_[2];
  std::unique_ptr<Buffer> prescribed_dofs_, prescribed_columns_, field_dofs_, keys_, load_dofs_,
      load_begin_, load_columns_, load_forces_, pressure_dofs_, pressure_begin_,
      pressure_node_faces_, faces_, face_shapes_;
};

}  // namespace tledface
