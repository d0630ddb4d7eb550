/* One step of a model predictive controller: C99, no allocation, nothing but <math.h>. Include it in one source file.

     static @n@_state s;
     @n@_reset(&s, u0);                      inputs (@N@_INPUTS) at rest, inside their limits
     status = @n@_step(&s, x, r, u);         x: @N@_STATES measurements, NaN where there is none; r: @N@_HORIZON rows of
                                             @N@_OUTPUTS wanted outputs from the next step on, NaN where free; u: the
                                             inputs to apply until the next measurement
   The status is one of @N@_SOLVED, @N@_PLAN, @N@_TARGET, @N@_HOLD, @N@_REST: solved, or what stood in for a solution.
   s.missing and s.rejected count entries of the measurement, s.iterations those of the solver. Infinite measurements
   count as missing. */

enum { @N@_SOLVED = 0, @N@_PLAN = 1, @N@_TARGET = 2, @N@_HOLD = 3, @N@_REST = 4 };

#define @N@_MOVES (@N@_STAGES * @N@_COORDINATES)
#define @N@_ROWS (2 * @N@_STAGES * @N@_MOVING)

typedef struct {
  double states[(@N@_DELAYS + 1) * @N@_STATES];
  double inputs[@N@_DELAYS * @N@_INPUTS + 1];
  double latest[@N@_INPUTS];
  double w[@N@_LIFTED], predicted[@N@_LIFTED], readout[@N@_STATES];
  double plan[@N@_MOVES], commanded[@N@_INPUTS], rest[@N@_INPUTS], wanted[@N@_OUTPUTS];
  double line[(@N@_LATE + 2) * @N@_INPUTS];
  int measured, known, read, planned, referenced, blind, left, idle, missing, rejected, iterations;
  int doubts[@N@_SENSORS + 1];
  double level;
  int factorised;
#if @N@_BILINEAR
  double S[@N@_STAGES * @N@_OUTPUTS * @N@_MOVES], grown[@N@_LIFTED * @N@_MOVES], before[@N@_LIFTED * @N@_MOVES];
#endif
  unsigned char specified[@N@_STAGES * @N@_OUTPUTS];
  double K[@N@_MOVES * @N@_MOVES];
  /* scratch of a step */
  double z[@N@_LIFTED], z2[@N@_LIFTED], x[@N@_STATES];
  double y[@N@_STAGES * @N@_OUTPUTS], q[@N@_MOVES], v[@N@_MOVES];
  double low[@N@_ROWS], high[@N@_ROWS];
  double J[@N@_MOVES * @N@_MOVES], R[@N@_MOVES * @N@_MOVES], L[@N@_MOVES * @N@_MOVES];
  double step[@N@_MOVES], d[@N@_MOVES], r[@N@_MOVES + 1], multiplier[@N@_MOVES + 1];
  int active[@N@_MOVES + 1], sign[@N@_MOVES + 1];
} @n@_state;

/* Eight sums beside each other, so that compilers need no leave to reorder one. */
static double @n@_dot(const double *a, const double *b, int n) {
  double s[8] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0}, sum = 0.0;
  int i = 0;
  for (; i + 8 <= n; i += 8)
    for (int l = 0; l < 8; ++l) s[l] += a[i + l] * b[i + l];
  for (; i < n; ++i) sum += a[i] * b[i];
  return sum + ((s[0] + s[4]) + (s[1] + s[5])) + ((s[2] + s[6]) + (s[3] + s[7]));
}
static int @n@_finite(const double *a, int n) {
  for (int i = 0; i < n; ++i)
    if (!isfinite(a[i])) return 0;
  return 1;
}

#if @N@_BILINEAR
/* after += sum_i u_i N_i z, on the rows that products change, from the columns that they have. */
static void @n@_products(const double *z, const double *u, double *after) {
  double part[@N@_COLUMNS + 1];
  for (int j = 0; j < @N@_COLUMNS; ++j) part[j] = z[@n@_column[j]];
  for (int i = 0; i < @N@_INPUTS; ++i)
    for (int k = 0; k < @N@_CHANGED; ++k)
      after[@n@_changed[k]] += u[i] * @n@_dot(@n@_N + (i * @N@_CHANGED + k) * @N@_COLUMNS, part, @N@_COLUMNS);
}
#endif
/* z+ = A z + B u (+ sum_i u_i N_i z) + c + w; a row of A is kept from its first to its last entry that is not zero. */
static void @n@_next(const double *z, const double *w, const double *u, double *after) {
  for (int i = 0; i < @N@_LIFTED; ++i) {
    const int first = @n@_span[3 * i], size = @n@_span[3 * i + 1], at = @n@_span[3 * i + 2];
    after[i] = @n@_dot(@n@_A + at, z + first, size) + @n@_dot(@n@_B + i * @N@_INPUTS, u, @N@_INPUTS) + @n@_c[i] + w[i];
  }
#if @N@_BILINEAR
  @n@_products(z, u, after);
#endif
}
static double @n@_read(int i, const double *z) {
  const int first = @n@_Cspan[3 * i], size = @n@_Cspan[3 * i + 1], at = @n@_Cspan[3 * i + 2];
  return @n@_dot(@n@_C + at, z + first, size) + @n@_d[i];
}

/* Limits: the plane offset + span(basis), the nearest point of a box on it, the input to apply after another. */
static void @n@_plane(const double *u, double *on) {
  double v[@N@_COORDINATES];
  for (int j = 0; j < @N@_COORDINATES; ++j) {
    v[j] = 0.0;
    for (int i = 0; i < @N@_INPUTS; ++i) v[j] += @n@_basis[i * @N@_COORDINATES + j] * (u[i] - @n@_offset[i]);
  }
  for (int i = 0; i < @N@_INPUTS; ++i)
    on[i] = @n@_offset[i] + @n@_dot(@n@_basis + i * @N@_COORDINATES, v, @N@_COORDINATES);
}
static double @n@_clip(double value, double low, double high) { return fmin(fmax(value, low), high); }
static double @n@_across(const double *u, const double *low, const double *high, double t, double *point) {
  double sum = 0.0;
  for (int i = 0; i < @N@_INPUTS; ++i) {
    point[i] = @n@_clip(u[i] - t * @n@_normal[i], low[i], high[i]);
    sum += (point[i] - @n@_offset[i]) * @n@_normal[i];
  }
  return sum;
}
/* 1 and the point in ``found`` if there is one. */
static int @n@_into(const double *u, const double *low, const double *high, double *found) {
  const int m = @N@_INPUTS;
  if (@N@_COORDINATES == m) {
    for (int i = 0; i < m; ++i) found[i] = @n@_clip(u[i], low[i], high[i]);
    return 1;
  }
  if (@N@_COORDINATES == m - 1) {
    double largest = 0.0, t[2 * @N@_INPUTS], before[@N@_INPUTS], after[@N@_INPUTS], old = 0.0;
    int count = 0;
    for (int i = 0; i < m; ++i) largest = fmax(largest, fabs(@n@_normal[i]));
    const double near = @N@_SPAN / largest;
    if (fabs(@n@_across(u, low, high, 0.0, found)) <= near) return 1;
    for (int i = 0; i < m; ++i)
      if (@n@_normal[i] != 0.0) {
        t[count++] = (u[i] - low[i]) / @n@_normal[i];
        t[count++] = (u[i] - high[i]) / @n@_normal[i];
      }
    for (int i = 1; i < count; ++i)
      for (int j = i; j > 0 && t[j] < t[j - 1]; --j) {
        const double kept = t[j];
        t[j] = t[j - 1];
        t[j - 1] = kept;
      }
    double here = @n@_across(u, low, high, t[0], found);
    if (here < 0.0) return fabs(here) <= near;
    double last = @n@_across(u, low, high, t[count - 1], before);
    if (last > 0.0) {
      for (int i = 0; i < m; ++i) found[i] = before[i];
      return fabs(last) <= near;
    }
    for (int k = 0; k < count; ++k) {
      here = @n@_across(u, low, high, t[k], after);
      if (here <= 0.0) {
        const double part = k ? old / (old - here) : 1.0;
        for (int i = 0; i < m; ++i)
          found[i] = k ? @n@_clip(before[i] + part * (after[i] - before[i]), low[i], high[i]) : after[i];
        return 1;
      }
      old = here;
      for (int i = 0; i < m; ++i) before[i] = after[i];
    }
    return 0;
  }
  double point[@N@_INPUTS];
  for (int i = 0; i < m; ++i) point[i] = u[i];
  for (int k = 0; k < 200; ++k) {
    double away = 0.0;
    for (int i = 0; i < m; ++i) found[i] = @n@_clip(point[i], low[i], high[i]);
    @n@_plane(found, point);
    for (int i = 0; i < m; ++i) away = fmax(away, fabs(point[i] - found[i]));
    if (away <= @N@_SPAN) return 1;
  }
  return 0;
}
static void @n@_coordinates(const double *u, double *v) {
  double near[@N@_INPUTS];
  if (!@n@_into(u, @n@_u_min, @n@_u_max, near)) @n@_plane(u, near);
  for (int j = 0; j < @N@_COORDINATES; ++j) {
    v[j] = 0.0;
    for (int i = 0; i < @N@_INPUTS; ++i) v[j] += @n@_basis[i * @N@_COORDINATES + j] * (near[i] - @n@_offset[i]);
    v[j] /= @N@_SCALE;
  }
}
static void @n@_project(const double *wanted, const double *before, double *u) {
  double low[@N@_INPUTS], high[@N@_INPUTS], goal[@N@_INPUTS], on[@N@_INPUTS], away = 0.0, fast = 1e-300;
  for (int i = 0; i < @N@_INPUTS; ++i) {
    low[i] = fmax(@n@_u_min[i], before[i] - @n@_du_max[i]);
    high[i] = fmin(@n@_u_max[i], before[i] + @n@_du_max[i]);
  }
  @n@_plane(before, on);
  for (int i = 0; i < @N@_INPUTS; ++i) away = fmax(away, fabs(on[i] - before[i]));
  if (away <= 10.0 * @N@_SPAN && @n@_into(wanted, low, high, goal)) {
    for (int i = 0; i < @N@_INPUTS; ++i) u[i] = goal[i];
    return;
  }
  if (!@n@_into(wanted, @n@_u_min, @n@_u_max, goal))
    for (int i = 0; i < @N@_INPUTS; ++i) goal[i] = @n@_clip(wanted[i], @n@_u_min[i], @n@_u_max[i]);
  for (int i = 0; i < @N@_INPUTS; ++i) fast = fmax(fast, fabs(goal[i] - before[i]) / @n@_du_max[i]);
  for (int i = 0; i < @N@_INPUTS; ++i)
    u[i] = @n@_clip(before[i] + (goal[i] - before[i]) * fmin(1.0, 1.0 / fast), low[i], high[i]);
}

/* K = L^-1 of P = L L^T (n, n), lower part given; 0 where P is not positive definite. */
static int @n@_factorise(const double *P, int n, double *L, double *K) {
  for (int j = 0; j < n; ++j)
    for (int i = j; i < n; ++i) {
      const double sum = P[i * n + j] - @n@_dot(L + i * n, L + j * n, j);
      if (i == j && !(sum > 0.0)) return 0;
      L[i * n + j] = i == j ? sqrt(sum) : sum / L[j * n + j];
    }
  for (int k = 0; k < n; ++k)
    for (int i = 0; i < n; ++i) {
      double sum = i == k ? 1.0 : 0.0;
      for (int j = k; j < i; ++j) sum -= L[i * n + j] * K[j * n + k];
      K[i * n + k] = i < k ? 0.0 : sum / L[i * n + i];
    }
  return 1;
}

/* Row of the problem: box of stage j, then change from stage j-1 to j; entries of ``a`` for stages ``last`` - 1, ``last``. */
static const double *@n@_row(int row, int stages, int *last, int *changes) {
  *changes = row >= stages * @N@_MOVING;
  row -= *changes ? stages * @N@_MOVING : 0;
  *last = row / @N@_MOVING;
  return @n@_rows + (row % @N@_MOVING) * @N@_COORDINATES;
}
static double @n@_value(int row, int stages, const double *v) {
  int last, changes;
  const double *a = @n@_row(row, stages, &last, &changes);
  double value = 0.0;
  for (int j = 0; j < @N@_COORDINATES; ++j) {
    value += a[j] * v[last * @N@_COORDINATES + j];
    if (changes && last) value -= a[j] * v[(last - 1) * @N@_COORDINATES + j];
  }
  return value;
}

/* y += a x */
static void @n@_add(double a, const double *x, double *y, int n) {
  for (int i = 0; i < n; ++i) y[i] += a * x[i];
}
/* Turn rows x and y (n) so that c x + e y becomes x. */
static void @n@_turn(double c, double e, double *x, double *y, int n) {
  for (int i = 0; i < n; ++i) {
    const double a = x[i], b = y[i];
    x[i] = c * a + e * b;
    y[i] = c * b - e * a;
  }
}

/* minimise x'Px/2 + q'x, s.low <= rows x <= s.high, P by K (n, n): the dual method of Goldfarb and Idnani, Mathematical
   Programming 27 (1983), with the transpose of its J in s.J. The solution in s.v; 0 where there is none. */
static int @n@_solve(@n@_state *s, const double *K, const double *q, int stages) {
  const int n = stages * @N@_COORDINATES, rows = 2 * stages * @N@_MOVING;
  double *J = s->J, *R = s->R;
  int active = 0;
  for (int i = 0; i < n * n; ++i) J[i] = K[i];
  for (int i = 0; i < n; ++i) s->v[i] = 0.0;
  for (int j = 0; j < n; ++j) @n@_add(-@n@_dot(J + j * n, q, n), J + j * n, s->v, n);
  for (s->iterations = 0; s->iterations < 50 * n + 50; ++s->iterations) {
    double worst = 1e-11, target = 0.0;
    int row = -1, sign = 0;
    for (int i = 0; i < rows; ++i) {
      const double value = @n@_value(i, stages, s->v);
      if (s->low[i] > s->high[i]) return 0;
      if (s->low[i] - value > worst) { worst = s->low[i] - value; row = i; sign = 1; target = s->low[i]; }
      if (value - s->high[i] > worst) { worst = value - s->high[i]; row = i; sign = -1; target = s->high[i]; }
    }
    if (row < 0) return 1;
    int last, changes;
    const double *a = @n@_row(row, stages, &last, &changes);
    double added = 0.0;
    for (;;) {
      for (int j = 0; j < n; ++j) {
        const double *here = J + j * n + last * @N@_COORDINATES;
        double sum = 0.0;
        for (int i = 0; i < @N@_COORDINATES; ++i)
          sum += a[i] * (changes && last ? here[i] - here[i - @N@_COORDINATES] : here[i]);
        s->d[j] = sign * sum;
      }
      double size = 0.0, all = 0.0;
      for (int j = 0; j < n; ++j) {
        all += s->d[j] * s->d[j];
        if (j >= active) size += s->d[j] * s->d[j];
      }
      for (int i = 0; i < n; ++i) s->step[i] = 0.0;
      for (int j = active; j < n; ++j) @n@_add(s->d[j], J + j * n, s->step, n);
      for (int i = active - 1; i >= 0; --i) {
        double sum = s->d[i];
        for (int j = i + 1; j < active; ++j) sum -= R[i * n + j] * s->r[j];
        s->r[i] = sum / R[i * n + i];
      }
      double dual = INFINITY, primal = INFINITY;
      int leaving = -1;
      for (int i = 0; i < active; ++i)
        if (s->r[i] > 0.0 && s->multiplier[i] / s->r[i] < dual) { dual = s->multiplier[i] / s->r[i]; leaving = i; }
      if (size > 1e-13 * all) primal = sign * (target - @n@_value(row, stages, s->v)) / size;
      const double t = fmin(dual, primal);
      if (!isfinite(t)) return 0;
      for (int i = 0; i < active; ++i) s->multiplier[i] -= t * s->r[i];
      added += t;
      if (isfinite(primal))
        for (int i = 0; i < n; ++i) s->v[i] += t * s->step[i];
      if (primal <= dual) { /* the row becomes active: the end of d is turned into its first entry */
        for (int j = n - 1; j > active; --j) {
          const double h = hypot(s->d[j - 1], s->d[j]);
          if (h == 0.0) continue;
          const double c = s->d[j - 1] / h, e = s->d[j] / h;
          s->d[j - 1] = h;
          @n@_turn(c, e, J + (j - 1) * n, J + j * n, n);
        }
        for (int i = 0; i <= active; ++i) R[i * n + active] = s->d[i];
        s->multiplier[active] = added;
        s->active[active] = row;
        s->sign[active++] = sign;
        break;
      }
      for (int k = leaving; k + 1 < active; ++k) { /* its column leaves R, which is made triangular again */
        for (int i = 0; i < active; ++i) R[i * n + k] = R[i * n + k + 1];
        s->multiplier[k] = s->multiplier[k + 1];
        s->active[k] = s->active[k + 1];
        s->sign[k] = s->sign[k + 1];
      }
      --active;
      for (int k = leaving; k < active; ++k) {
        const double h = hypot(R[k * n + k], R[(k + 1) * n + k]);
        if (h == 0.0) continue;
        const double c = R[k * n + k] / h, e = R[(k + 1) * n + k] / h;
        @n@_turn(c, e, R + k * n + k, R + (k + 1) * n + k, active - k);
        @n@_turn(c, e, J + k * n, J + (k + 1) * n, n);
      }
    }
  }
  return 0;
}

#if @N@_BILINEAR
#define @N@_RESPONSE s->S
/* Outputs s.y at no moves, and s.S, their derivative along the shifted plan, from z, which is left at its end. */
static void @n@_along(@n@_state *s, double *z, double *after) {
  const int n = @N@_MOVES, r = @N@_COORDINATES;
  double u[@N@_INPUTS], part[@N@_COLUMNS + 1], slope[@N@_INPUTS], N[@N@_CHANGED * @N@_COLUMNS + 1];
  for (int j = 0; j < @N@_STAGES; ++j) {
    for (int i = 0; i < @N@_INPUTS; ++i)
      u[i] = @n@_offset[i] + @N@_SCALE * @n@_dot(@n@_basis + i * r, s->plan + j * r, r);
    for (int i = 0; i < @N@_LIFTED; ++i) { /* A on what earlier moves did, B on this one */
      const int first = @n@_span[3 * i], size = @n@_span[3 * i + 1], at = @n@_span[3 * i + 2];
      double *row = s->grown + i * n;
      for (int k = 0; k < n; ++k) row[k] = 0.0;
      if (j)
        for (int l = 0; l < size; ++l) @n@_add(@n@_A[at + l], s->before + (first + l) * n, row, j * r);
      for (int l = 0; l < @N@_INPUTS; ++l)
        for (int k = 0; k < r; ++k) row[j * r + k] += @N@_SCALE * @n@_B[i * @N@_INPUTS + l] * @n@_basis[l * r + k];
    }
    for (int k = 0; k < @N@_COLUMNS; ++k) part[k] = z[@n@_column[k]];
    for (int k = 0; k < @N@_CHANGED * @N@_COLUMNS; ++k) {
      N[k] = 0.0;
      for (int i = 0; i < @N@_INPUTS; ++i) N[k] += u[i] * @n@_N[i * @N@_CHANGED * @N@_COLUMNS + k];
    }
    for (int k = 0; k < @N@_CHANGED; ++k) {
      double *row = s->grown + @n@_changed[k] * n;
      if (j)
        for (int l = 0; l < @N@_COLUMNS; ++l)
          @n@_add(N[k * @N@_COLUMNS + l], s->before + @n@_column[l] * n, row, j * r);
      for (int i = 0; i < @N@_INPUTS; ++i)
        slope[i] = @n@_dot(@n@_N + (i * @N@_CHANGED + k) * @N@_COLUMNS, part, @N@_COLUMNS);
      for (int i = 0; i < @N@_INPUTS; ++i)
        for (int l = 0; l < r; ++l) row[j * r + l] += @N@_SCALE * slope[i] * @n@_basis[i * r + l];
    }
    @n@_next(z, s->w, u, after);
    for (int i = 0; i < @N@_LIFTED; ++i) z[i] = after[i];
    for (int l = 0; l < @N@_OUTPUTS; ++l) {
      const int i = @n@_tracked[l];
      const int first = @n@_Cspan[3 * i], size = @n@_Cspan[3 * i + 1], at = @n@_Cspan[3 * i + 2];
      double *row = s->S + (j * @N@_OUTPUTS + l) * n;
      for (int k = 0; k < n; ++k) row[k] = 0.0;
      for (int k = 0; k < size; ++k) @n@_add(@n@_C[at + k], s->grown + (first + k) * n, row, (j + 1) * r);
      s->y[j * @N@_OUTPUTS + l] = @n@_read(i, z) + s->readout[i] - @n@_dot(row, s->plan, (j + 1) * r);
    }
    for (int k = 0; k < @N@_LIFTED * n; ++k) s->before[k] = s->grown[k];
  }
}
#else
#define @N@_RESPONSE @n@_S
#endif

/* The plan for outputs s.y that are free, reference r and coordinates v of the input before. */
static int @n@_plan(@n@_state *s, const double *r, const double *v) {
  const int n = @N@_MOVES, p = @N@_STAGES * @N@_OUTPUTS, k = @N@_STAGES * @N@_MOVING;
  if (!@n@_finite(s->y, p)) return 0;
#if @N@_BILINEAR
  if (!@n@_finite(s->S, p * n)) return 0;
#endif
  int changed = @N@_BILINEAR || !s->factorised;
  for (int i = 0; i < p; ++i) {
    const unsigned char known = !isnan(r[i]);
    changed |= known != s->specified[i];
    s->specified[i] = known;
  }
  if (changed) {
    double *P = s->R;
    for (int i = 0; i < n; ++i)
      for (int j = 0; j <= i; ++j) P[i * n + j] = @n@_moved[i * n + j];
    for (int l = 0; l < p; ++l)
      if (s->specified[l])
        for (int i = 0; i < n; ++i)
          for (int j = 0; j <= i; ++j) P[i * n + j] += @N@_RESPONSE[l * n + i] * @n@_Q[l] * @N@_RESPONSE[l * n + j];
    s->factorised = @n@_factorise(P, n, s->L, s->K);
    if (!s->factorised) return 0;
  }
  for (int i = 0; i < n; ++i) s->q[i] = 0.0;
  for (int l = 0; l < p; ++l)
    if (s->specified[l]) {
      const double pull = @n@_Q[l] * (s->y[l] - r[l]);
      for (int i = 0; i < n; ++i) s->q[i] += pull * @N@_RESPONSE[l * n + i];
    }
  for (int i = 0; i < @N@_COORDINATES; ++i)
    s->q[i] -= @n@_dot(@n@_change + i * @N@_COORDINATES, v, @N@_COORDINATES);
  if (!@n@_finite(s->q, n)) return 0;
  for (int i = 0; i < k; ++i) {
    const int input = i % @N@_MOVING;
    const double anchor =
        i < @N@_MOVING ? @n@_dot(@n@_rows + input * @N@_COORDINATES, v, @N@_COORDINATES) : 0.0;
    s->low[i] = @n@_low[input];
    s->high[i] = @n@_high[input];
    s->low[k + i] = anchor - @n@_fastest[input];
    s->high[k + i] = anchor + @n@_fastest[input];
  }
  if (!@n@_solve(s, s->K, s->q, @N@_STAGES)) return 0;
  for (int i = 0; i < n; ++i) s->plan[i] = s->v[i];
  return 1;
}

/* The input u under which the model rests nearest to r (@N@_OUTPUTS); 0 where it comes to no rest. */
static int @n@_target(@n@_state *s, const double *r, double *u) {
  const int n = @N@_COORDINATES;
  double v[@N@_COORDINATES], K[@N@_COORDINATES * @N@_COORDINATES], P[@N@_COORDINATES * @N@_COORDINATES];
  double q[@N@_COORDINATES];
  if (!@N@_RESTS || !@n@_finite(s->w, @N@_LIFTED)) return 0;
  @n@_coordinates(s->commanded, v);
  for (int i = 0; i < n; ++i) {
    q[i] = 0.0;
    for (int j = 0; j < n; ++j) {
      P[i * n + j] = @n@_stay[i * n + j];
      q[i] -= @n@_stay[i * n + j] * v[j];
    }
  }
  for (int l = 0; l < @N@_OUTPUTS; ++l) {
    if (isnan(r[l])) continue;
    const double *Y = @n@_rest_gain + l * n;
    const double miss = @n@_rest_output[l] + @n@_dot(@n@_rest_push + l * @N@_LIFTED, s->w, @N@_LIFTED) +
                        s->readout[@n@_tracked[l]] - r[l];
    for (int i = 0; i < n; ++i) {
      q[i] += @n@_rest_weight[l] * Y[i] * miss;
      for (int j = 0; j < n; ++j) P[i * n + j] += @n@_rest_weight[l] * Y[i] * Y[j];
    }
  }
  if (!@n@_factorise(P, n, s->L, K)) return 0;
  for (int i = 0; i < @N@_MOVING; ++i) {
    s->low[i] = @n@_low[i];
    s->high[i] = @n@_high[i];
    s->low[@N@_MOVING + i] = -INFINITY;
    s->high[@N@_MOVING + i] = INFINITY;
  }
  if (!@n@_solve(s, K, q, 1)) return 0;
  for (int i = 0; i < @N@_INPUTS; ++i)
    u[i] = @n@_offset[i] + @N@_SCALE * @n@_dot(@n@_basis + i * @N@_COORDINATES, s->v, @N@_COORDINATES);
  return 1;
}

/* What is applied without a solution; ``planned``: the next move of the last plan. */
static int @n@_fallback(@n@_state *s, const double *planned, const double *r, int known, double *u) {
  double goal[@N@_INPUTS], most = 0.0;
  if (s->left > 0) {
    --s->left;
    s->idle = 0;
    @n@_project(planned, s->commanded, u);
    return @N@_PLAN;
  }
  const int idle = s->idle++;
  if (idle < @N@_STAGES && known && @n@_target(s, r, goal)) {
    for (int i = 0; i < @N@_INPUTS; ++i) most = fmax(most, fabs(goal[i] - s->commanded[i]) / @n@_half[i]);
    if (most < @N@_THERE)
      for (int i = 0; i < @N@_INPUTS; ++i) u[i] = s->commanded[i];
    else
      @n@_project(goal, s->commanded, u);
    return @N@_TARGET;
  }
  for (int i = 0; i < @N@_INPUTS; ++i) most = fmax(most, fabs(s->rest[i] - s->commanded[i]) / @n@_half[i]);
  for (int i = 0; i < @N@_INPUTS; ++i) u[i] = s->commanded[i];
  if (idle < 2 * @N@_STAGES || most == 0.0) return @N@_HOLD;
  for (int i = 0; i < @N@_INPUTS; ++i)
    goal[i] = s->commanded[i] + (s->rest[i] - s->commanded[i]) / fmax(1.0, most * @N@_SLOWLY * @N@_STAGES);
  @n@_project(goal, s->commanded, u);
  return @N@_REST;
}

/* The lifted state in s.z; 0 while nothing is known. */
static int @n@_lifted(@n@_state *s) {
  const int known = s->known && @n@_finite(s->predicted, @N@_LIFTED);
  s->rejected = 0;
  if (@N@_SENSORS && known) {
    for (int i = 0; i < @N@_LIFTED; ++i) s->z[i] = s->predicted[i];
    double sizes = 0.0;
    int seen = 0;
    for (int l = 0; l < @N@_SENSORS; ++l) {
      const int i = @n@_sensors[l];
      const double innovation = s->x[i] - @n@_read(i, s->predicted);
      const double size = fabs(innovation) / @n@_usual[l];
      const int doubted = size > @N@_GATE * fmax(1.0, s->level) && s->doubts[l] < @N@_PATIENCE;
      if (!isnan(innovation)) {
        sizes += fmin(size, @N@_CLIPPED * fmax(1.0, s->level));
        ++seen;
      }
      s->doubts[l] = doubted ? s->doubts[l] + 1 : 0;
      s->rejected += doubted;
      if (doubted || isnan(innovation)) continue;
      for (int j = 0; j < @N@_LIFTED; ++j) s->z[j] += @n@_gain[l * @N@_LIFTED + j] * innovation;
    }
    if (seen) s->level += @N@_NEWEST * (sizes / seen / @N@_MEAN_SIZE - s->level);
    for (int i = 0; i < @N@_STATES; ++i) s->readout[i] = 0.0;
    s->read = 1;
    return 1;
  }
  if (@N@_SENSORS && @N@_RESTING && s->missing) { /* at rest, as far as anybody knows */
    for (int i = 0; i < @N@_LIFTED; ++i)
      s->z2[i] = s->z[i] = @n@_rest_state[i] + @n@_dot(@n@_rest_slope + i * @N@_INPUTS, s->latest, @N@_INPUTS);
    for (int l = 0; l < @N@_SENSORS; ++l) {
      const double innovation = s->x[@n@_sensors[l]] - @n@_read(@n@_sensors[l], s->z2);
      for (int j = 0; j < @N@_LIFTED; ++j) s->z[j] += isnan(innovation) ? 0.0 : @n@_gain[l * @N@_LIFTED + j] * innovation;
    }
    for (int i = 0; i < @N@_STATES; ++i) s->readout[i] = 0.0;
    s->read = 1;
    return 1;
  }
  for (int i = 0; i < @N@_STATES; ++i)
    if (isnan(s->x[i])) {
      if (!(known && s->read)) return 0;
      s->x[i] = @n@_read(i, s->predicted) + s->readout[i];
    }
  for (int k = 0; k < @N@_DELAYS; ++k)
    for (int i = 0; i < @N@_STATES; ++i)
      s->states[k * @N@_STATES + i] = s->measured ? s->states[(k + 1) * @N@_STATES + i] : s->x[i];
  for (int i = 0; i < @N@_STATES; ++i) s->states[@N@_DELAYS * @N@_STATES + i] = s->x[i];
  s->measured = 1;
  @n@_lift(s->states, s->inputs, s->z);
  for (int i = 0; i < @N@_STATES; ++i) s->readout[i] = @N@_SENSORS ? 0.0 : s->x[i] - @n@_read(i, s->z);
  s->read = 1;
  return 1;
}

static void @n@_reset(@n@_state *s, const double *u0) {
  for (int i = 0; i < @N@_LIFTED; ++i) s->w[i] = s->predicted[i] = 0.0;
  for (int i = 0; i < @N@_STATES; ++i) s->readout[i] = 0.0;
  for (int k = 0; k < @N@_DELAYS; ++k)
    for (int i = 0; i < @N@_INPUTS; ++i) s->inputs[k * @N@_INPUTS + i] = u0[i];
  for (int k = 0; k < @N@_LATE + 2; ++k)
    for (int i = 0; i < @N@_INPUTS; ++i) s->line[k * @N@_INPUTS + i] = u0[i];
  for (int i = 0; i < @N@_INPUTS; ++i) s->commanded[i] = s->rest[i] = s->latest[i] = u0[i];
  for (int i = 0; i < @N@_SENSORS; ++i) s->doubts[i] = 0;
  s->level = 1.0;
  for (int i = 0; i < @N@_MOVES; ++i) s->plan[i] = 0.0;
  s->measured = s->known = s->read = s->planned = s->referenced = s->blind = s->left = s->idle = 0;
  s->missing = s->rejected = s->iterations = s->factorised = 0;
}

static int @n@_step(@n@_state *s, const double *x, const double *reference, double *u) {
  double r[@N@_STAGES * @N@_OUTPUTS], v[@N@_COORDINATES], planned[@N@_INPUTS], acting[@N@_INPUTS];
  /* The reference at the times of the outputs that the plan decides on. */
  for (int k = 0; k < @N@_STAGES; ++k)
    for (int l = 0; l < @N@_OUTPUTS; ++l) {
      double found[2] = {0.0, 0.0};
      for (int e = 0; e < (@N@_SHIFT_PART > 0.0 ? 2 : 1); ++e) {
        const int row = @N@_SHIFT + k + e; /* 0: the next sample, -1: this one */
        found[e] = row >= 0 ? reference[row * @N@_OUTPUTS + l] : s->referenced ? s->wanted[l] : reference[l];
      }
      r[k * @N@_OUTPUTS + l] =
          @N@_SHIFT_PART > 0.0 ? (1.0 - @N@_SHIFT_PART) * found[0] + @N@_SHIFT_PART * found[1] : found[0];
    }
  for (int l = 0; l < @N@_OUTPUTS; ++l) s->wanted[l] = reference[l];
  s->referenced = 1;
  s->missing = 0;
  for (int i = 0; i < @N@_STATES; ++i) {
    s->x[i] = isfinite(x[i]) ? x[i] : NAN;
    s->missing += isnan(s->x[i]) ? 1 : 0;
  }
  s->blind = s->missing == @N@_STATES ? s->blind + 1 : 0;
  @n@_coordinates(s->commanded, v);
  for (int k = 0; k < @N@_STAGES; ++k)
    for (int j = 0; j < @N@_COORDINATES; ++j) {
      const int next = k + 1 < @N@_STAGES ? k + 1 : k;
      s->plan[k * @N@_COORDINATES + j] = s->planned ? s->plan[next * @N@_COORDINATES + j] : v[j];
    }
  s->planned = 1;
  const int known = @n@_lifted(s);
  int solved = 0;
  s->iterations = 0;
  if (known) {
    if (s->known && @N@_GAIN > 0.0) {
      int good = 1;
      for (int i = 0; i < @N@_LIFTED; ++i) good &= isfinite(s->z[i] - s->predicted[i]) != 0;
      for (int i = 0; i < @N@_LIFTED && good; ++i) s->w[i] += @N@_GAIN * (s->z[i] - s->predicted[i]);
    }
    double *z = s->z2, *after = s->predicted; /* predicted is made anew below */
    for (int i = 0; i < @N@_LIFTED; ++i) z[i] = s->z[i];
    for (int k = 0; k < @N@_LATE; ++k) {
      for (int i = 0; i < @N@_INPUTS; ++i)
        acting[i] = (1.0 - @N@_PART) * s->line[(k + 2) * @N@_INPUTS + i] + @N@_PART * s->line[(k + 1) * @N@_INPUTS + i];
      @n@_next(z, s->w, acting, after);
      for (int i = 0; i < @N@_LIFTED; ++i) z[i] = after[i];
    }
#if @N@_BILINEAR
    @n@_along(s, z, after);
#else
    for (int l = 0; l < @N@_STAGES * @N@_OUTPUTS; ++l)
      s->y[l] = @n@_dot(@n@_free + l * @N@_LIFTED, z, @N@_LIFTED) + @n@_dot(@n@_push + l * @N@_LIFTED, s->w, @N@_LIFTED) +
                @n@_constant[l] + @n@_dot(@n@_late + l * @N@_COORDINATES, v, @N@_COORDINATES) +
                s->readout[@n@_tracked[l % @N@_OUTPUTS]];
#endif
    if (s->blind <= @N@_STAGES) solved = @n@_plan(s, r, v);
  }
  for (int i = 0; i < @N@_INPUTS; ++i)
    planned[i] = @n@_offset[i] + @N@_SCALE * @n@_dot(@n@_basis + i * @N@_COORDINATES, s->plan, @N@_COORDINATES);
  int status = @N@_SOLVED;
  if (solved) {
    s->left = @N@_STAGES - 1;
    s->idle = 0;
    @n@_project(planned, s->commanded, u);
  } else {
    status = @n@_fallback(s, planned, r, known, u);
    if (status != @N@_PLAN) {
      @n@_coordinates(u, v);
      for (int k = 0; k < @N@_MOVES; ++k) s->plan[k] = v[k % @N@_COORDINATES];
    }
  }
  for (int i = 0; i < (@N@_LATE + 1) * @N@_INPUTS; ++i) s->line[i] = s->line[i + @N@_INPUTS];
  for (int i = 0; i < @N@_INPUTS; ++i) {
    s->line[(@N@_LATE + 1) * @N@_INPUTS + i] = s->commanded[i] = u[i];
    s->latest[i] = acting[i] = (1.0 - @N@_PART) * s->line[@N@_INPUTS + i] + @N@_PART * s->line[i];
  }
  if (known) @n@_next(s->z, s->w, acting, s->predicted);
  s->known = known;
  for (int k = 0; k + 1 < @N@_DELAYS; ++k)
    for (int i = 0; i < @N@_INPUTS; ++i) s->inputs[k * @N@_INPUTS + i] = s->inputs[(k + 1) * @N@_INPUTS + i];
  if (@N@_DELAYS)
    for (int i = 0; i < @N@_INPUTS; ++i) s->inputs[(@N@_DELAYS - 1) * @N@_INPUTS + i] = acting[i];
  return status;
}
