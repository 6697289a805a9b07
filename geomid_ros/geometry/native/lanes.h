/* Eight symmetric 4x4 matrices at once.
 *
 * Each entry of the eight matrices is stored side by side (in lanes), and nothing branches. So the compiler vectorises
 * each operation over eight numbers, ten times as fast as one LAPACK call each. The ten entries of a matrix are in the
 * order of spd.py: diagonal, then upper triangle row by row. Coordinates have a factor sqrt(2) off the diagonal.
 */
#ifndef GEOMID_LANES_H
#define GEOMID_LANES_H

#include <math.h>
#include <string.h>

#define LANES 8
#define TINY 1e-300
#define ROOT_HALF 0.70710678118654752440
#define ROOT_TWO 1.41421356237309504880
#define INLINE static inline __attribute__((always_inline))

/* The loader picks the version of such a function that fits the processor. */
#if defined(__x86_64__) && defined(__GLIBC__) && __GNUC__ >= 12 && !defined(__clang__)
#define FOR_EACH_PROCESSOR __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define FOR_EACH_PROCESSOR
#endif

typedef double Lane[LANES];
typedef double Vector __attribute__((vector_size(8 * LANES))); /* a Lane in registers */

INLINE Vector loaded(const double *lane) {
    Vector result;
    memcpy(&result, lane, sizeof result);
    return result;
}

typedef struct {
    Lane values[10];    /* entries; after the decomposition the first four are the eigenvalues */
    Lane vectors[4][4]; /* columns are the eigenvectors */
} Eigen;

static const int ROW[10] = {0, 1, 2, 3, 0, 0, 0, 1, 1, 2};
static const int COLUMN[10] = {0, 1, 2, 3, 1, 2, 3, 2, 3, 3};
static const int PLACE[4][4] = {{0, 4, 5, 6}, {4, 1, 7, 8}, {5, 7, 2, 9}, {6, 8, 9, 3}};

/* Rotate in the plane of p and q so that the entry pq becomes zero; k and m are the two other rows. */
INLINE void rotate(Eigen *e, int p, int q, int k, int m) {
    Lane *a = e->values;
    const int pp = PLACE[p][p], qq = PLACE[q][q], pq = PLACE[p][q];
    const int kp = PLACE[k][p], kq = PLACE[k][q], mp = PLACE[m][p], mq = PLACE[m][q];
    for (int i = 0; i < LANES; i++) {
        const double apq = a[pq][i], half = 0.5 * (a[qq][i] - a[pp][i]);
        const double size = sqrt(half * half + apq * apq) + TINY; /* avoids 0/0 where the entries are zero */
        const double tangent = apq / (half + copysign(size, half));
        const double c = 1.0 / sqrt(tangent * tangent + 1.0), s = tangent * c;
        const double akp = a[kp][i], akq = a[kq][i], amp = a[mp][i], amq = a[mq][i];
        a[pp][i] -= tangent * apq;
        a[qq][i] += tangent * apq;
        a[pq][i] = 0.0;
        a[kp][i] = c * akp - s * akq;
        a[kq][i] = s * akp + c * akq;
        a[mp][i] = c * amp - s * amq;
        a[mq][i] = s * amp + c * amq;
        for (int r = 0; r < 4; r++) {
            const double vp = e->vectors[r][p][i], vq = e->vectors[r][q][i];
            e->vectors[r][p][i] = c * vp - s * vq;
            e->vectors[r][q][i] = s * vp + c * vq;
        }
    }
}

/* Diagonalise the entries by cyclic Jacobi rotations (Golub & Van Loan, "Matrix Computations", section 8.5). The
 * eigenvalues are exact up to rounding relative to the matrix's norm. All lanes take as many sweeps as the slowest. */
INLINE void diagonalise(Eigen *e) {
    memset(e->vectors, 0, sizeof e->vectors);
    for (int k = 0; k < 4; k++)
        for (int i = 0; i < LANES; i++) e->vectors[k][k][i] = 1.0;
    for (int sweep = 0; sweep < 12; sweep++) {
        int done = 1;
        for (int i = 0; i < LANES; i++) {
            double off = 0.0, scale = 0.0;
            for (int k = 4; k < 10; k++) off += e->values[k][i] * e->values[k][i];
            for (int k = 0; k < 4; k++) scale += e->values[k][i] * e->values[k][i];
            done &= off <= 1e-32 * (off + scale);
        }
        if (done) return;
        rotate(e, 0, 1, 2, 3);
        rotate(e, 2, 3, 0, 1);
        rotate(e, 0, 2, 1, 3);
        rotate(e, 1, 3, 0, 2);
        rotate(e, 0, 3, 1, 2);
        rotate(e, 1, 2, 0, 3);
    }
}

/* Entries of the matrices with eigenvalues `sizes` and the eigenvectors of e. */
INLINE void composed(const Eigen *e, Lane sizes[4], Lane result[10]) {
    for (int a = 0; a < 10; a++)
        for (int i = 0; i < LANES; i++) {
            double sum = 0.0;
            for (int k = 0; k < 4; k++) sum += sizes[k][i] * e->vectors[ROW[a]][k][i] * e->vectors[COLUMN[a]][k][i];
            result[a][i] = sum;
        }
}

/* Entries of G X G for symmetric G and X. */
INLINE void congruent(Lane g[10], Lane x[10], Lane result[10]) {
    Lane half[4][4];
    for (int r = 0; r < 4; r++)
        for (int c = 0; c < 4; c++)
            for (int i = 0; i < LANES; i++) {
                double sum = 0.0;
                for (int k = 0; k < 4; k++) sum += g[PLACE[r][k]][i] * x[PLACE[k][c]][i];
                half[r][c][i] = sum;
            }
    for (int a = 0; a < 10; a++)
        for (int i = 0; i < LANES; i++) {
            double sum = 0.0;
            for (int k = 0; k < 4; k++) sum += half[ROW[a]][k][i] * g[PLACE[k][COLUMN[a]]][i];
            result[a][i] = sum;
        }
}

/* Load matrices (4, 4) of up to eight links into lanes; unused lanes get the identity. */
INLINE void gather(const double *matrices, int links, Lane result[10]) {
    for (int a = 0; a < 10; a++)
        for (int i = 0; i < LANES; i++)
            result[a][i] = i < links ? matrices[16 * i + 4 * ROW[a] + COLUMN[a]] : (double)(a < 4);
}

/* Load coordinates (10,) of up to eight links into lanes as entries; unused lanes get zero. */
INLINE void gather_coordinates(const double *coordinates, int links, Lane result[10]) {
    for (int a = 0; a < 10; a++)
        for (int i = 0; i < LANES; i++)
            result[a][i] = i < links ? coordinates[10 * i + a] * (a < 4 ? 1.0 : ROOT_HALF) : 0.0;
}

#endif
