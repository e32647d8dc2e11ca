// Tension-length law of Warburton & Maddock 2014, eq. 8-12:
// S_M = J (alpha sigma_act f_act + sigma_pas f_pas) d (x) d, stretch = |F d|,
// f_act = -25/(4 lo^2) stretch^2 + 25/(2 lo) stretch - 5.25 where positive (0.6 lo to 1.4 lo),
// f_pas = 0 up to 1, 0.05 (e^(6.6 (stretch - 1)) - 1) up to lambda_pas, then a line of slope 2.18.
#define MUSCLE_SIGMA_ACT 0      // Pa
#define MUSCLE_SQUARE 1         // -25/(4 lo^2)
#define MUSCLE_LINEAR 2         // 25/(2 lo)
#define MUSCLE_SIGMA_PAS 3      // Pa
#define MUSCLE_LAMBDA_PAS 4
#define MUSCLE_LINE_OFFSET 5    // f_pas of the line at stretch 0
#define MUSCLE_CALCIUM 6        // 1: the calcium law below instead
#define MUSCLE_BETA 7           // its slope over stretch

// Calcium activation (Hung et al. 2009, eq. 3; Hunter et al. 1998): Cauchy fibre stress
// sigma_act activation (1 + beta (stretch - 1)), activation the Hill function of the calcium level
// (taken on the host). S_M = J F^-1 (sigma a (x) a) F^-T = J sigma/stretch^2 d (x) d.
INLINE realv calcium_tension(__global const real* constants, real activation, realv stretch) {
  const realv zero = broadcast(R(0.0)), one = broadcast(R(1.0));
  realv sigma = R(1.0) + constants[MUSCLE_BETA] * (stretch - R(1.0));
  sigma = sigma > zero ? sigma : zero;
  const realv square = stretch * stretch;  // 0 where there is no fibre
  return (activation * constants[MUSCLE_SIGMA_ACT]) * sigma / (square > zero ? square : one);
}

// The eighth of 6.6 (stretch - 1), as far as the exponential goes.
INLINE realv passive_exponent(realv stretch, real lambda_pas) {
  realv within = stretch > R(1.0) ? stretch : broadcast(R(1.0));
  within = within < lambda_pas ? within : broadcast(lambda_pas);
  return R(0.825) * within - R(0.825);
}

// Fibre stress over J, Pa. What takes longest comes last: much of an element waits for this.
INLINE realv muscle_tension(__global const real* constants, real activation, realv stretch) {
  if (constants[MUSCLE_CALCIUM] > R(0.5)) return calcium_tension(constants, activation, stretch);
  const real lambda_pas = constants[MUSCLE_LAMBDA_PAS], sigma_pas = constants[MUSCLE_SIGMA_PAS];
  realv active = stretch * (constants[MUSCLE_LINEAR] + stretch * constants[MUSCLE_SQUARE]) - R(5.25);
  active = active > R(0.0) ? active : broadcast(R(0.0));
  active = (activation * constants[MUSCLE_SIGMA_ACT]) * active;
  const realv on_line = active + sigma_pas * (constants[MUSCLE_LINE_OFFSET] + R(2.18) * stretch);
  const real scale = R(0.05) * sigma_pas;
  const realv on_curve =
      (active - scale) + scale * exponential_of_eight(passive_exponent(stretch, lambda_pas));
  return stretch < lambda_pas ? on_curve : on_line;
}

// Slope of muscle_tension over stretch, Pa.
INLINE realv muscle_tension_slope(__global const real* constants, real activation, realv stretch) {
  const realv zero = broadcast(R(0.0)), one = broadcast(R(1.0));
  const real sigma_act = activation * constants[MUSCLE_SIGMA_ACT];
  if (constants[MUSCLE_CALCIUM] > R(0.5)) {
    const real beta = constants[MUSCLE_BETA];
    realv sigma = R(1.0) + beta * (stretch - R(1.0)), square = stretch * stretch;
    const realv slope = sigma > zero ? broadcast(beta) : zero;
    sigma = sigma > zero ? sigma : zero;
    square = square > zero ? square : one;
    return sigma_act * (slope - R(2.0) * sigma * stretch / square) / square;
  }
  const real linear = constants[MUSCLE_LINEAR], squared = constants[MUSCLE_SQUARE];
  const realv active = stretch * (linear + stretch * squared) - R(5.25);
  const realv active_slope = active > zero ? linear + stretch * (R(2.0) * squared) : zero;
  const real lambda_pas = constants[MUSCLE_LAMBDA_PAS];
  realv passive_slope = R(0.33) * exponential_of_eight(passive_exponent(stretch, lambda_pas));
  passive_slope = stretch > R(1.0) ? passive_slope : zero;
  passive_slope = stretch < lambda_pas ? passive_slope : broadcast(R(2.18));
  return sigma_act * active_slope + constants[MUSCLE_SIGMA_PAS] * passive_slope;
}
