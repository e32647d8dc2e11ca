// Elementary functions on realv without a division and without a library call, so that every
// executor does the same operations. Their error is measured by tests/verification/test_laws.py.

// One step towards t^(-1/3) from y, of fourth order: y (1 + c/3 + 2c^2/9 + 14c^3/81), c = 1 - t y^3.
INLINE realv closer_inverse_cube_root(realv t, realv y) {
  const realv c = R(1.0) - t * y * y * y;
  return y + y * (c * (R(1.0 / 3.0) + c * (R(2.0 / 9.0) + c * R(14.0 / 81.0))));
}

// (1 + t)^(-1/3) for |t| <= 1/4 in single precision, 1 at 0: a polynomial of least relative error, 1.5e-8. Its
// terms are summed by pairs, since all the rest of an element waits for it: half the time of a guess and a
// step towards the root, and 5 % of that of a block.
INLINE realv inverse_cube_root_near_1(realv t) {
  const realv t2 = t * t;
  const realv low = R(-0.333333289) + t * R(0.222226849), middle = R(-0.172850222) + t * R(0.143589602),
              high = R(-0.124200743) + t * R(0.122887044) + t2 * R(-0.113486733);
  return R(1.0) + t * ((low + t2 * middle) + (t2 * t2) * high);
}

// |x|^(-1/3) for 1/32 < |x| < 32, which covers any volume ratio of an element that means something.
// Beyond 32 digits are lost.
INLINE realv inverse_cube_root(realv with_sign) {
#if !TLED_DOUBLE
  const realv change = with_sign - R(1.0);
  if (all_below(absolute(change), broadcast(R(0.25)))) return inverse_cube_root_near_1(change);
#endif
  const realv x = absolute(with_sign);
  realv y;
  if (all_below(absolute(x - R(1.25)), broadcast(R(0.75)))) {
    // Least relative error cubic on [1/2, 2], 0.4 % at most: 1e-8 after one step.
    y = R(1.73773006) + x * (R(-1.25184487) + x * (R(0.63499611) + x * R(-0.12291288)));
    y = closer_inverse_cube_root(x, y);
#if TLED_DOUBLE
    y = closer_inverse_cube_root(x, y);
#endif
    return y;
  }
  // x is first brought into [1/4, 4] by a selected factor of 8.
  const realv one = broadcast(R(1.0)), scale_up = broadcast(R(8.0)), scale_down = broadcast(R(0.125));
  const realv root_up = broadcast(R(2.0)), root_down = broadcast(R(0.5));
  const realv scale = x > R(4.0) ? scale_down : (x < R(0.25) ? scale_up : one);
  const realv root = x > R(4.0) ? root_down : (x < R(0.25) ? root_up : one);
  const realv t = x * scale;
  // Least relative error quintic on [1/4, 4], 1.3 % at most: 4e-7 after one step.
  y = R(2.02957792) +
      t * (R(-2.27795943) +
           t * (R(1.90489128) + t * (R(-0.83137353) + t * (R(0.17629349) + t * R(-0.0143529)))));
  y = closer_inverse_cube_root(t, y);
#if TLED_DOUBLE
  y = closer_inverse_cube_root(t, y);
#endif
  return y * root;
}

// e^(8 t) for 0 <= t <= 1/2: the Taylor polynomial of e^t, squared three times. Relative error below
// 3e-6 (float, at t = 0.16: 3e-7) and 1e-13 (double). In single precision two by two, since whoever needs
// it waits for the whole.
INLINE realv exponential_of_eight(realv t) {
#if TLED_DOUBLE
  realv y = R(1.0) +
            t * (R(1.0) +
                 t * (R(1.0 / 2) +
                      t * (R(1.0 / 6) +
                           t * (R(1.0 / 24) +
                                t * (R(1.0 / 120) +
                                     t * (R(1.0 / 720) +
                                          t * (R(1.0 / 5040) +
                                               t * (R(1.0 / 40320) +
                                                    t * (R(1.0 / 362880) +
                                                         t * (R(1.0 / 3628800) +
                                                              t * R(1.0 / 39916800)))))))))));
#else
  const realv square = t * t;
  const realv low = (R(1.0) + t) + square * (R(1.0 / 2) + t * R(1.0 / 6));
  const realv high = (R(1.0 / 24) + t * R(1.0 / 120)) + square * R(1.0 / 720);
  realv y = low + (square * square) * high;
#endif
  y = y * y;
  y = y * y;
  return y * y;
}
