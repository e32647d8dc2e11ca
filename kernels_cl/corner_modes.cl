// Between the Walsh-Hadamard sums of an element's corners as arrays, s[component][mode] with bits of
// the mode 1 x, 2 y, 4 z, and the named modes of element.cl. For the kernels whose work-item is an
// element. The sum mode, 0, is not needed and no force has a share in it.
INLINE ElementModes named_modes(const real s[3][8]) {
  ElementModes m;
  m.linear.xx = s[0][1];
  m.linear.xy = s[0][2];
  m.linear.xz = s[0][4];
  m.linear.yx = s[1][1];
  m.linear.yy = s[1][2];
  m.linear.yz = s[1][4];
  m.linear.zx = s[2][1];
  m.linear.zy = s[2][2];
  m.linear.zz = s[2][4];
  m.hourglass.xy.x = s[0][3];
  m.hourglass.xy.y = s[1][3];
  m.hourglass.xy.z = s[2][3];
  m.hourglass.zx.x = s[0][5];
  m.hourglass.zx.y = s[1][5];
  m.hourglass.zx.z = s[2][5];
  m.hourglass.yz.x = s[0][6];
  m.hourglass.yz.y = s[1][6];
  m.hourglass.yz.z = s[2][6];
  m.hourglass.xyz.x = s[0][7];
  m.hourglass.xyz.y = s[1][7];
  m.hourglass.xyz.z = s[2][7];
  return m;
}

INLINE void modes_as_arrays(ElementModes f, real s[3][8]) {
  s[0][0] = s[1][0] = s[2][0] = R(0.0);
  s[0][1] = f.linear.xx;
  s[0][2] = f.linear.xy;
  s[0][3] = f.hourglass.xy.x;
  s[0][4] = f.linear.xz;
  s[0][5] = f.hourglass.zx.x;
  s[0][6] = f.hourglass.yz.x;
  s[0][7] = f.hourglass.xyz.x;
  s[1][1] = f.linear.yx;
  s[1][2] = f.linear.yy;
  s[1][3] = f.hourglass.xy.y;
  s[1][4] = f.linear.yz;
  s[1][5] = f.hourglass.zx.y;
  s[1][6] = f.hourglass.yz.y;
  s[1][7] = f.hourglass.xyz.y;
  s[2][1] = f.linear.zx;
  s[2][2] = f.linear.zy;
  s[2][3] = f.hourglass.xy.z;
  s[2][4] = f.linear.zz;
  s[2][5] = f.hourglass.zx.z;
  s[2][6] = f.hourglass.yz.z;
  s[2][7] = f.hourglass.xyz.z;
}
