// The twin of shim.hpp, with the same words, whose rows have one lane and count what is done with
// them: the kernels' own text then says how many vector instructions an element costs. Products
// that are only added to something become multiply-adds, as -ffp-contract=fast makes them: all of a
// product's uses, or none.
#pragma once
#include <utility>

#include "backend/native/operation_counts.hpp"

#define TLED_OPENCL 0
#define TLED_VECTOR_ROWS 1
#define __kernel static
#define __global
#define restrict __restrict__
#define LOADS_AHEAD 1

namespace {

typedef float real;
#define R(x) (static_cast<real>(x))

// What is done to single nodes is not counted.
#include "backend/native/border_group.hpp"

thread_local unsigned long current_item = 0;
inline unsigned long get_global_id(unsigned) { return current_item; }
inline void prefetch_line(const real*) {}
inline void prefetch_to_read(const real*) {}
inline void prefetch_to_second(const real*) {}

thread_local tledface::native::OperationCounts counts;

// A product that may still become part of the sums that use it.
struct Product {
  int handles = 1, sums = 0;
  bool otherwise_used = false;
};

class Counted {
 public:
  Counted() = default;
  explicit Counted(real value) : value_(value) {}
  Counted(const Counted& other)
      : value_(other.value_), product_(other.product_), is_one_(other.is_one_) {
    if (product_) ++product_->handles;
  }
  Counted(Counted&& other) noexcept
      : value_(other.value_), product_(other.product_), is_one_(other.is_one_) {
    other.product_ = nullptr;
  }
  Counted& operator=(Counted other) noexcept {
    std::swap(value_, other.value_);
    std::swap(product_, other.product_);
    std::swap(is_one_, other.is_one_);
    return *this;
  }
  ~Counted() {
    if (!product_ || --product_->handles) return;
    if (product_->sums && !product_->otherwise_used) {
      counts.multiplied -= 1;
      counts.added -= product_->sums;
      counts.fused += product_->sums;
    }
    delete product_;
  }

  // The value for anything but a sum.
  real use() const {
    if (product_) product_->otherwise_used = true;
    return value_;
  }
  // The value for a sum; at most one of its two terms is fused with it.
  real add(bool& fused) const {
    if (product_ && !fused) {
      ++product_->sums;
      fused = true;
    } else if (product_) {
      product_->otherwise_used = true;
    }
    return value_;
  }
  static Counted product(real value) {
    counts.multiplied += 1;
    Counted result(value);
    result.product_ = new Product;
    return result;
  }
  // A row of the constant 1, whose products compilers leave out.
  static Counted constant(real value) {
    Counted result(value);
    result.is_one_ = value == 1;
    return result;
  }
  bool is_one() const { return is_one_; }
  static Counted sum(real value) {
    counts.added += 1;
    return Counted(value);
  }
  real operator[](int) const { return use(); }
  real& operator[](int) {
    use();
    return value_;
  }

 private:
  real value_ = 0;
  Product* product_ = nullptr;
  bool is_one_ = false;
};

inline Counted operator*(const Counted& a, const Counted& b) {
  if (a.is_one()) return b;
  if (b.is_one()) return a;
  return Counted::product(a.use() * b.use());
}
inline Counted operator*(real a, const Counted& b) { return Counted::product(a * b.use()); }
inline Counted operator*(const Counted& a, real b) { return Counted::product(a.use() * b); }
inline Counted operator+(const Counted& a, const Counted& b) {
  bool fused = false;
  const real first = a.add(fused);
  return Counted::sum(first + b.add(fused));
}
inline Counted operator+(real a, const Counted& b) { return Counted(a) + b; }
inline Counted operator+(const Counted& a, real b) { return a + Counted(b); }
inline Counted operator-(const Counted& a, const Counted& b) {
  bool fused = false;
  const real first = a.add(fused);
  return Counted::sum(first - b.add(fused));
}
inline Counted operator-(real a, const Counted& b) { return Counted(a) - b; }
inline Counted operator-(const Counted& a, real b) { return a - Counted(b); }
inline Counted operator-(const Counted& a) {
  counts.selected += 1;
  return Counted(-a.use());
}
inline Counted operator/(const Counted& a, const Counted& b) {
  counts.divided += 1;
  return Counted(a.use() / b.use());
}
inline Counted operator/(real a, const Counted& b) { return Counted(a) / b; }
inline Counted operator/(const Counted& a, real b) { return a / Counted(b); }
inline Counted& operator+=(Counted& a, const Counted& b) { return a = a + b; }
inline Counted& operator-=(Counted& a, const Counted& b) { return a = a - b; }
inline Counted& operator*=(Counted& a, const Counted& b) { return a = a * b; }
inline Counted& operator*=(Counted& a, real b) { return a = a * b; }
inline Counted& operator+=(Counted& a, real b) { return a = a + b; }

// A comparison and the selection that it is for.
inline bool compared(bool result) {
  counts.selected += 2;
  return result;
}
#define TLED_COMPARISON(op)                                                            \
  inline bool operator op(const Counted& a, const Counted& b) {                        \
    return compared(a.use() op b.use());                                               \
  }                                                                                    \
  inline bool operator op(const Counted& a, real b) { return compared(a.use() op b); } \
  inline bool operator op(real a, const Counted& b) { return compared(a op b.use()); }
TLED_COMPARISON(<)
TLED_COMPARISON(>)
TLED_COMPARISON(<=)
TLED_COMPARISON(>=)
TLED_COMPARISON(==)
TLED_COMPARISON(!=)
#undef TLED_COMPARISON

typedef Counted realv;
inline realv broadcast(real x) { return Counted::constant(x); }
inline realv load_lanes(const real* p) { return Counted(*p); }
inline void store_lanes(const realv& v, real* p) { *p = v.use(); }
inline realv gather_lanes(const real* p, const int* at) { return Counted(p[*at]); }
inline int lanes_not_below(const realv& a, const realv& b) { return !(a < b); }
inline int lowest_bit(int bits) { return __builtin_ctz(static_cast<unsigned>(bits)); }
inline int all_below(const realv& a, const realv& b) { return a < b; }
// With one lane what is one on is the next block's, what is one before the last block's; shifts of
// lanes are counted as blocks of more of them need them.
inline realv next_in_x(const realv& own, const realv& next) {
  counts.shuffled += 1;
  own.use();
  return Counted(next.use());
}
inline realv next_in_y(const realv&, const realv& next) {
  counts.shuffled += 1;
  return next;
}
inline realv previous_in_x(const realv& own, const realv& before) {
  counts.shuffled += 1;
  own.use();
  return Counted(before.use());
}
inline realv previous_in_y(const realv&, const realv& before) {
  counts.shuffled += 1;
  return before;
}
inline realv previous_behind_edge(const realv& own, const real* edge, const int component) {
  return previous_in_x(own, Counted(edge[component + 1]));
}
inline void store_last(const realv& a, const realv& b, const realv& c, real* p) {
  counts.shuffled += 2;
  p[1] = a.use();
  p[2] = b.use();
  p[3] = c.use();
}
inline real lane_of(const realv& v, int) { return v.use(); }
inline realv square_root(const realv& x) {
  counts.roots += 1;
  return Counted(static_cast<real>(__builtin_sqrt(x.use())));
}
inline realv natural_log(const realv& x) {
  return Counted(static_cast<real>(__builtin_log(x.use())));
}
inline realv natural_exp(const realv& x) {
  return Counted(static_cast<real>(__builtin_exp(x.use())));
}
inline realv absolute(const realv& x) {
  counts.selected += 1;
  return Counted(static_cast<real>(__builtin_fabs(x.use())));
}

}  // namespace
