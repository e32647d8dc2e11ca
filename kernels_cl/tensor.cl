// Small tensors of lanes. Rows are components of the current configuration (c), columns axes of
// the reference one (d): F.xy = dx/dY.
typedef struct { realv x, y, z; } Vec;
typedef struct { realv xx, xy, xz, yx, yy, yz, zx, zy, zz; } Tensor;

INLINE void clear_tensor(Tensor* T) {
  T->xx = broadcast(R(0.0));
  T->xy = T->xz = T->yx = T->yy = T->yz = T->zx = T->zy = T->zz = T->xx;
}

INLINE realv dot_product(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// Cofactors: cof F = J F^-T.
INLINE Tensor cofactors(Tensor F) {
  Tensor C;
  C.xx = F.yy * F.zz - F.yz * F.zy;
  C.xy = F.yz * F.zx - F.yx * F.zz;
  C.xz = F.yx * F.zy - F.yy * F.zx;
  C.yx = F.zy * F.xz - F.zz * F.xy;
  C.yy = F.zz * F.xx - F.zx * F.xz;
  C.yz = F.zx * F.xy - F.zy * F.xx;
  C.zx = F.xy * F.yz - F.xz * F.yy;
  C.zy = F.xz * F.yx - F.xx * F.yz;
  C.zz = F.xx * F.yy - F.xy * F.yx;
  return C;
}

INLINE realv squared_norm(Tensor F) {
  return F.xx * F.xx + F.xy * F.xy + F.xz * F.xz + F.yx * F.yx + F.yy * F.yy + F.yz * F.yz +
         F.zx * F.zx + F.zy * F.zy + F.zz * F.zz;
}
