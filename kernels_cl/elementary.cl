// Elementary functions on realv without a division and without a library call, so that every
// executor does the same operations. Their error is measured by tests/verification/test_laws.py.

// x^(-1/3) for 1/32 < x < 32, which covers any volume ratio of an element that means something. x is
// first brought into [1/4, 4] by a selected factor of 8. Beyond 32 digits are lost.
INLINE realv inverse_cube_root(realv x) {
  const realv one = broadcast(R(1.0)), scale_up = broadcast(R(8.0)), scale_down = broadcast(R(0.125));
  const realv root_up = broadcast(R(2.0)), root_down = broadcast(R(0.5));
  realv scale = x > R(4.0) ? scale_down : (x < R(0.25) ? scale_up : one);
  realv root = x > R(4.0) ? root_down : (x < R(0.25) ? root_up : one);
  realv t = x * scale;
  // Start: least relative error quintic of t^(-1/3) on [1/4, 4], 1.3 % at most.
  realv y = R(2.02957792) +
            t * (R(-2.27795943) +
                 t * (R(1.90489128) +
                      t * (R(-0.83137353) + t * (R(0.17629349) + t * R(-0.0143529)))));
  // y <- y (1 + c/3 + 2c^2/9 + 14c^3/81) with c = 1 - t y^3: fourth order, 4e-7 after one.
  realv c = one - t * y * y * y;
  y = y + y * (c * (R(1.0 / 3.0) + c * (R(2.0 / 9.0) + c * R(14.0 / 81.0))));
#if TLED_DOUBLE
  c = one - t * y * y * y;
  y = y + y * (c * (R(1.0 / 3.0) + c * (R(2.0 / 9.0) + c * R(14.0 / 81.0))));
#endif
  return y * root;
}

// e^x for 0 <= x <= 4: the Taylor polynomial of e^(x/8), squared three times. Relative error below
// 3e-6 (float, at x = 1.3: 3e-7) and 1e-13 (double).
INLINE realv exponential(realv x) {
  realv t = x * R(0.125);
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
  realv y = R(1.0) +
            t * (R(1.0) +
                 t * (R(1.0 / 2) +
                      t * (R(1.0 / 6) +
                           t * (R(1.0 / 24) + t * (R(1.0 / 120) + t * R(1.0 / 720))))));
#endif
  y = y * y;
  y = y * y;
  return y * y;
}
