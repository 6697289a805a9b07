/* Objective of the fits, evaluated thousands of times, and the solver's step; see objective.py and manifold.py. */
#include <Python.h>

#include "native.h"

#include "lanes.h"

static const double SHRINKS_STRAIGHT = 0.5, SMALLEST_FACTOR = 0.05;

/* Compute pseudo-inertias (links, 4, 4) at the ends of straight lines from `base` with tangents `steps` (links, 10). */
FOR_EACH_PROCESSOR static void straight_lines(const double *base, const double *steps, int links, double *ends) {
    for (int first = 0; first < links; first += LANES) {
        const int some = links - first < LANES ? links - first : LANES;
        Eigen own, step;
        Lane roots[4], root[10], change[10], end[10];
        gather(base + 16 * first, some, own.values);
        diagonalise(&own);
        for (int k = 0; k < 4; k++)
            for (int i = 0; i < LANES; i++) roots[k][i] = sqrt(own.values[k][i]);
        composed(&own, roots, root);
        gather_coordinates(steps + 10 * first, some, step.values);
        memcpy(change, step.values, sizeof change);
        int longest = 0; /* no eigenvalue of shorter steps can be beyond */
        for (int i = 0; i < some; i++) {
            double square = 0.0;
            for (int a = 0; a < 10; a++) square += (a < 4 ? 1.0 : 2.0) * change[a][i] * change[a][i];
            longest |= !(square <= SHRINKS_STRAIGHT * SHRINKS_STRAIGHT);
        }
        for (int k = 0; k < 4; k++)
            for (int i = 0; i < LANES; i++) change[k][i] += 1.0;
        if (longest) {
            diagonalise(&step);
            for (int k = 0; k < 4; k++)
                for (int i = 0; i < LANES; i++) {
                    const double size = step.values[k][i];
                    double shrunk = size + SHRINKS_STRAIGHT;
                    shrunk = 0.5 * exp(2.0 * (shrunk < 0.0 ? shrunk : 0.0));
                    shrunk = shrunk > SMALLEST_FACTOR ? shrunk : SMALLEST_FACTOR;
                    roots[k][i] = size > -SHRINKS_STRAIGHT ? 1.0 + size : shrunk;
                }
            composed(&step, roots, change);
        }
        congruent(root, change, end);
        for (int i = 0; i < some; i++)
            for (int r = 0; r < 4; r++)
                for (int c = 0; c < 4; c++) ends[16 * (first + i) + 4 * r + c] = end[PLACE[r][c]][i];
    }
}

/* Compute coordinates of v_k v_k^T and (v_k v_m^T + v_m v_k^T) / sqrt(2) for the columns v of a matrix. For a symmetric
 * matrix G they are the rows of the matrix from the coordinates of X to those of G X G. */
INLINE void pairs(double v[4][4], double basis[10][10]) {
    for (int a = 0; a < 10; a++) {
        const int k = ROW[a], m = COLUMN[a];
        for (int b = 0; b < 10; b++) {
            const int r = ROW[b], c = COLUMN[b];
            const double scale = 0.5 * (a < 4 ? 1.0 : ROOT_TWO) * (b < 4 ? 1.0 : ROOT_TWO);
            basis[a][b] = scale * (v[r][k] * v[c][m] + v[r][m] * v[c][k]);
        }
    }
}

enum { MEASURED, KNOWN, KINDS }; /* kinds of rows */

/* Rows of one kind: their derivative (D,), and products (D + 1, D + 1) of the columns; the last row and column are
 * unused. `basis` maps a link's coordinates to the rows' parameters; the next link's is `next` numbers further. */
typedef struct {
    const double *basis, *slope, *products;
    long next;
} Rows;

/* Terms of half the squared distance to the prior, per link: coordinates of the logarithm, Hessian along geodesics, and
 * Jacobians of each kind's parameters by tangent coordinates. */
typedef struct {
    double logarithm[10], bends[10][10], jacobian[KINDS][10][10];
} Link;

INLINE void links_terms(
    const double *inertias, const double *priors, const Rows *rows, int links, Link *result) {
    for (int first = 0; first < links; first += LANES) {
        const int some = links - first < LANES ? links - first : LANES;
        Eigen own, between;
        Lane sizes[4], root[10], inverse[10], prior[10], logarithm[10];
        gather(inertias + 16 * first, some, own.values);
        gather(priors + 16 * first, some, prior);
        diagonalise(&own);
        for (int k = 0; k < 4; k++)
            for (int i = 0; i < LANES; i++) sizes[k][i] = sqrt(own.values[k][i]);
        composed(&own, sizes, root);
        for (int k = 0; k < 4; k++)
            for (int i = 0; i < LANES; i++) sizes[k][i] = 1.0 / sizes[k][i];
        composed(&own, sizes, inverse);
        congruent(inverse, prior, between.values);
        diagonalise(&between);
        for (int k = 0; k < 4; k++)
            for (int i = 0; i < LANES; i++) sizes[k][i] = log(between.values[k][i]);
        composed(&between, sizes, logarithm);
        for (int i = 0; i < some; i++) {
            Link *link = result + first + i;
            double turned[10][10], bend[10], vectors[4][4], own_root[4][4], taken[10][10];
            for (int r = 0; r < 4; r++)
                for (int c = 0; c < 4; c++) {
                    vectors[r][c] = between.vectors[r][c][i];
                    own_root[r][c] = root[PLACE[r][c]][i];
                }
            for (int a = 0; a < 10; a++) {
                const double half = 0.5 * (sizes[ROW[a]][i] - sizes[COLUMN[a]][i]);
                bend[a] = fabs(half) < 1e-6 ? 1.0 : half / tanh(half);
                link->logarithm[a] = logarithm[a][i] * (a < 4 ? 1.0 : ROOT_TWO);
            }
            pairs(vectors, turned);
            pairs(own_root, taken);
            memset(link->bends, 0, sizeof link->bends);
            memset(link->jacobian, 0, sizeof link->jacobian);
            for (int a = 0; a < 10; a++)
                for (int r = 0; r < 10; r++) {
                    const double bent = bend[a] * turned[a][r];
                    for (int c = 0; c < 10; c++) link->bends[r][c] += bent * turned[a][c];
                    for (int kind = 0; kind < KINDS; kind++) {
                        const double into = rows[kind].basis[(first + i) * rows[kind].next + 10 * r + a];
                        for (int c = 0; c < 10; c++) link->jacobian[kind][r][c] += into * taken[a][c];
                    }
                }
        }
    }
}

/* Compute the second derivative of tr(X exp(Q)) by the coordinates of Q; x (10,) are the coordinates of X. */
INLINE void of_lines(const double *x, double result[10][10]) {
    double matrix[4][4];
    for (int r = 0; r < 4; r++)
        for (int c = 0; c < 4; c++) matrix[r][c] = x[PLACE[r][c]] * (r == c ? 1.0 : ROOT_HALF);
    /* tr(X (E_a E_b + E_b E_a)) / 2, where E_a has scale s_a at (i, j) and at (j, i) */
    for (int a = 0; a < 10; a++)
        for (int b = 0; b < 10; b++) {
            const int i = ROW[a], j = COLUMN[a], k = ROW[b], m = COLUMN[b];
            double sum = 0.0;
            sum += j == k ? matrix[m][i] : 0.0; /* (i, j)(k, m) */
            if (k != m) sum += j == m ? matrix[k][i] : 0.0;
            if (i != j) sum += i == k ? matrix[m][j] : 0.0;
            if (i != j && k != m) sum += i == m ? matrix[k][j] : 0.0;
            result[a][b] = sum * (a < 4 ? 1.0 : ROOT_HALF) * (b < 4 ? 1.0 : ROOT_HALF);
        }
}

/* True if two links have no products, because no channel depends on both. */
INLINE int apart(const double *products, long stride) {
    for (int r = 0; r < 10; r++)
        for (int c = 0; c < 10; c++)
            if (products[r * stride + c] != 0.0) return 0;
    return 1;
}

/* Add to a block the products of two links, in their tangent coordinates. */
INLINE void add_products(
    const double *products, long stride, const double left[10][10], const double right[10][10], double block[10][10]) {
    double half[10][10] = {{0.0}};
    if (apart(products, stride)) return;
    for (int r = 0; r < 10; r++, products += stride)
        for (int k = 0; k < 10; k++)
            for (int c = 0; c < 10; c++) half[r][c] += products[k] * right[k][c];
    for (int k = 0; k < 10; k++)
        for (int r = 0; r < 10; r++)
            for (int c = 0; c < 10; c++) block[r][c] += left[k][r] * half[k][c];
}

typedef struct {
    int links, positives, size;
    const double *inertias, *priors; /* (links, 4, 4) */
    const double *rest, *prior_rest, *scales; /* coefficients; scales of the real ones */
    const double *weights; /* (D,) */
    Rows rows[KINDS];
    double *gradient, *information, *hessian; /* (D,), (D, D), (D, D) */
    Link *terms;
} Problem;

FOR_EACH_PROCESSOR static double second_order(const Problem *p) {
    const int size = p->size, inertial = 10 * p->links, stride = size + 1;
    double value = 0.0;
    links_terms(p->inertias, p->priors, p->rows, p->links, p->terms);
    memset(p->information, 0, sizeof(double) * size * size);
    for (int link = 0; link < p->links; link++) {
        const Link *row = p->terms + link;
        for (int a = 0; a < 10; a++) {
            const double pull = p->weights[10 * link + a] * row->logarithm[a];
            value += 0.5 * pull * row->logarithm[a];
            double slope = 0.0;
            for (int kind = 0; kind < KINDS; kind++)
                for (int r = 0; r < 10; r++) slope += p->rows[kind].slope[10 * link + r] * row->jacobian[kind][r][a];
            p->gradient[10 * link + a] = slope - pull;
        }
        for (int other = link; other < p->links; other++) {
            const Link *column = p->terms + other;
            double block[10][10] = {{0.0}};
            for (int kind = 0; kind < KINDS; kind++)
                add_products(
                    p->rows[kind].products + (long)(10 * link) * stride + 10 * other, stride, row->jacobian[kind],
                    column->jacobian[kind], block);
            for (int r = 0; r < 10; r++)
                for (int c = 0; c < 10; c++) {
                    p->information[(long)(10 * link + r) * size + 10 * other + c] = block[r][c];
                    p->information[(long)(10 * other + c) * size + 10 * link + r] = block[r][c];
                }
        }
    }
    for (int k = inertial; k < size; k++) {
        const int own = k - inertial, positive = own < p->positives;
        const double length = positive ? p->rest[own] : p->scales[own - p->positives];
        const double off = p->prior_rest[own];
        const double logarithm = positive ? log(off / p->rest[own]) : (off - p->rest[own]) / length;
        const double pull = p->weights[k] * logarithm;
        value += 0.5 * pull * logarithm;
        double slope = 0.0;
        for (int kind = 0; kind < KINDS; kind++) slope += p->rows[kind].slope[k];
        p->gradient[k] = slope * length - pull;
        for (int link = 0; link < p->links; link++) {
            double row[10] = {0.0};
            for (int kind = 0; kind < KINDS; kind++)
                for (int r = 0; r < 10; r++) {
                    const double product = p->rows[kind].products[(long)k * stride + 10 * link + r];
                    if (product == 0.0) continue;
                    for (int c = 0; c < 10; c++) row[c] += product * p->terms[link].jacobian[kind][r][c];
                }
            for (int c = 0; c < 10; c++) {
                p->information[(long)k * size + 10 * link + c] = length * row[c];
                p->information[(long)(10 * link + c) * size + k] = length * row[c];
            }
        }
        for (int m = inertial; m < size; m++) {
            const int at = m - inertial;
            const double other = at < p->positives ? p->rest[at] : p->scales[at - p->positives];
            double product = 0.0;
            for (int kind = 0; kind < KINDS; kind++) product += p->rows[kind].products[(long)k * stride + m];
            p->information[(long)k * size + m] = length * other * product;
        }
    }
    memcpy(p->hessian, p->information, sizeof(double) * size * size);
    for (int link = 0; link < p->links; link++) {
        double pull[10], line[10][10];
        const double weight = p->weights[10 * link];
        for (int a = 0; a < 10; a++) pull[a] = weight * p->terms[link].logarithm[a];
        of_lines(pull, line);
        for (int r = 0; r < 10; r++)
            for (int c = 0; c < 10; c++)
                p->hessian[(long)(10 * link + r) * size + 10 * link + c] +=
                    weight * p->terms[link].bends[r][c] + line[r][c];
    }
    for (int k = inertial; k < size; k++) {
        const int own = k - inertial;
        const double pull = own < p->positives ? log(p->prior_rest[own] / p->rest[own]) : 0.0;
        p->hessian[(long)k * size + k] += p->weights[k] * (1.0 + pull);
    }
    return value;
}

/* Products (width, width) of each channel's columns, one channel after the other. Columns in use, up to the channel's
 * `ends`: `rows` are their indices in its products, `places` indices among all in use. In a run, which ends
 * at `runs`, columns are neighbours in both. */
typedef struct {
    const double *products;
    const long long *widths, *rows, *places, *runs, *ends;
} Packed;

enum { TILE = 32 };

/* Sum of squares that determines a channel's noise, with a lower bound. */
INLINE double noise(double square, double least) { return square < least ? least : square; /* NaN stays NaN */ }

/* Compute the channels' sums of squares at `vector` (size,). Unless `total` is NULL, also sum the products, weighted by
 * each channel's count over its sum of squares (bounded from below by `least`). */
FOR_EACH_PROCESSOR static void weigh(
    const Packed *packed, const double *restrict vector, const double *counts, const double *least, int channels, int size,
    double *restrict own, double *squares, double *restrict total) {
    const double *products = packed->products;
    if (total) memset(total, 0, sizeof(double) * size * size);
    long long begin = 0;
    for (int channel = 0; channel < channels; begin = packed->ends[channel++]) {
        const long long m = packed->ends[channel] - begin, width = packed->widths[channel];
        const long long *at = packed->places + begin, *from = packed->rows + begin, *until = packed->runs + begin;
        double square = 0.0;
        for (long long k = 0; k < m; k++) own[k] = vector[at[k]];
        for (long long k = 0; k < m; k++) {
            const double *row = products + from[k] * width;
            Lane moved = {0.0};
            for (long long j = k + 1; j < m;) {
                const long long end = until[j];
                const double *run = row + from[j] - j;
                for (; j + LANES <= end; j += LANES)
                    for (int lane = 0; lane < LANES; lane++) moved[lane] += run[j + lane] * own[j + lane];
                for (; j < end; j++) moved[0] += run[j] * own[j];
            }
            double sum = 0.0;
            for (int lane = 0; lane < LANES; lane++) sum += moved[lane];
            square += own[k] * (row[from[k]] * own[k] + 2.0 * sum);
        }
        squares[channel] = square;
        const double weight = counts[channel] / noise(square, least[channel]);
        for (long long k = 0; total && k < m; k++) {
            const double *row = products + from[k] * width;
            for (long long j = k; j < m;) {
                const long long end = until[j];
                const double *run = row + from[j] - j;
                double *into = total + at[k] * size + at[j] - j;
                for (; j < end; j++) into[j] += weight * run[j];
            }
        }
        products += width * width;
    }
    for (int row = 0; total && row < size; row += TILE) /* by tiles, which fit into the cache */
        for (int column = 0; column <= row; column += TILE)
            for (int i = row; i < size && i < row + TILE; i++)
                for (int j = column; j < i && j < column + TILE; j++)
                    total[(long)i * size + j] = total[(long)j * size + i];
}

/* Objective of profile_objective.py, and buffers for an evaluation. `problem` holds everything that does not depend on
 * the point. Known rows are given at the prior. */
typedef struct {
    Problem problem;
    int channels;
    Packed packed;
    const double *counts, *least;
    double *squares, *total, *vector, *off, *slope, *pull;
} Profile;

typedef struct {
    double value, *inertias, *rest, *gradient, *information, *hessian;
} State;

INLINE double dot(const double *x, const double *y, int count) {
    Vector lanes = {0.0};
    double sum = 0.0;
    int k = 0;
    for (; k + LANES <= count; k += LANES) lanes += loaded(x + k) * loaded(y + k);
    for (; k < count; k++) sum += x[k] * y[k];
    for (int lane = 0; lane < LANES; lane++) sum += lanes[lane];
    return sum;
}

/* Compute parameters (D,) of links and coefficients, for one kind of rows. */
static void parameters_of(
    const Problem *p, const Rows *rows, const double *inertias, const double *rest, double *result) {
    for (int link = 0; link < p->links; link++)
        for (int r = 0; r < 10; r++) {
            double sum = 0.0;
            for (int a = 0; a < 10; a++)
                sum += rows->basis[link * rows->next + 10 * r + a] * (a < 4 ? 1.0 : ROOT_TWO) * inertias[16 * link + 4 * ROW[a] + COLUMN[a]];
            result[10 * link + r] = sum;
        }
    memcpy(result + 10 * p->links, rest, sizeof(double) * (p->size - 10 * p->links));
}

FOR_EACH_PROCESSOR static void evaluate(const Profile *profile, State *at) {
    Problem problem = profile->problem;
    const Rows *known = problem.rows + KNOWN;
    const int size = problem.size, stride = size + 1;
    double *vector = profile->vector, *slope = profile->slope, *total = profile->total, value = 0.0;
    parameters_of(&problem, problem.rows + MEASURED, at->inertias, at->rest, vector);
    vector[size] = -1.0;
    weigh(
        &profile->packed, vector, profile->counts, profile->least, profile->channels, stride, slope, profile->squares,
        total);
    for (int channel = 0; channel < profile->channels; channel++) {
        const double square = profile->squares[channel], expected = noise(square, profile->least[channel]);
        value += 0.5 * profile->counts[channel] * (log(expected) + square / expected - 1.0);
    }
    for (int k = 0; k < size; k++) slope[k] = dot(total + (long)k * stride, vector, stride);
    double *off = profile->off, *pull = profile->pull;
    parameters_of(&problem, known, problem.priors, problem.prior_rest, off);
    parameters_of(&problem, known, at->inertias, at->rest, vector);
    for (int k = 0; k < size; k++) off[k] = vector[k] - off[k];
    off[size] = 1.0;
    for (int k = 0; k < stride; k++) {
        pull[k] = dot(known->products + (long)k * stride, off, stride);
        value += 0.5 * off[k] * pull[k];
    }
    problem.inertias = at->inertias;
    problem.rest = at->rest;
    problem.gradient = at->gradient;
    problem.information = at->information;
    problem.hessian = at->hessian;
    at->value = value + second_order(&problem);
}

/* Take a step along a straight line. */
static void stepped(const Problem *p, const State *from, const double *tangent, State *to) {
    const int inertial = 10 * p->links;
    straight_lines(from->inertias, tangent, p->links, to->inertias);
    for (int k = inertial; k < p->size; k++)
        to->rest[k - inertial] = from->rest[k - inertial] + p->scales[k - inertial] * tangent[k];
}

static int is_finite(const State *at, int size) {
    Vector lanes = {0.0};
    double sum = at->value;
    for (int k = 0; k < size; k++) sum += at->gradient[k];
    long k = 0, count = (long)size * size;
    for (; k + LANES <= count; k += LANES) lanes += loaded(at->hessian + k);
    for (; k < count; k++) sum += at->hessian[k];
    for (int lane = 0; lane < LANES; lane++) sum += lanes[lane];
    return isfinite(sum);
}

/* Subtract `times` the vector `taken` from `onto`. */
INLINE void less(double *restrict onto, const double *restrict taken, double times, int count) {
    for (int k = 0; k < count; k++) onto[k] -= times * taken[k];
}

enum {
    TOGETHER = 4, /* rows eliminated at once */
    STRETCHES = 32,
};

/* Find at most STRETCHES of columns before `size`, from each `begin` to its `end`, outside of which `count` rows are
 * zero; return how many there are. */
INLINE int stretches(const double *const *rows, int count, int size, int *begin, int *end) {
    int found = 0;
    for (int first = 0; first < size; first += LANES) {
        const int last = first + LANES < size ? first + LANES : size;
        int used = 0;
        for (int row = 0; row < count; row++)
            for (int j = first; j < last; j++) used |= rows[row][j] != 0.0;
        if (!used) continue;
        if (!found || (end[found - 1] < first && found < STRETCHES)) begin[found++] = first;
        end[found - 1] = last;
    }
    return found;
}

/* Overwrite `matrix` by the lower triangle L (size, size) with L^T L = `matrix`; return 0 if not positive definite.
 *
 * Rows are eliminated from the last to the first. Coefficients come after the links, and links after their proximal
 * links. So a row only gets entries of columns with which it shares channels, and entries that are zero stay zero. */
INLINE int factored(double *matrix, int size) {
    for (int end = size; end > 0; end -= TOGETHER) {
        const int begin = end > TOGETHER ? end - TOGETHER : 0;
        const double *rows[TOGETHER] = {matrix};
        int from[STRETCHES], to[STRETCHES];
        for (int k = end - 1; k >= begin; k--) {
            double *row = matrix + (long)k * size;
            if (!(row[k] > 0.0)) return 0;
            const double inverse = 1.0 / sqrt(row[k]);
            for (int j = 0; j <= k; j++) row[j] *= inverse;
            for (int i = begin; i < k; i++) less(matrix + (long)i * size, row, row[i], i + 1);
            rows[end - 1 - k] = row;
        }
        for (int k = end - begin; k < TOGETHER; k++) rows[k] = rows[0];
        const int count = stretches(rows, TOGETHER, begin, from, to);
        for (int those = 0; those < count; those++)
            for (int i = from[those]; i < to[those]; i++) {
                const double p = rows[0][i], q = rows[1][i], r = rows[2][i], s = rows[3][i];
                if (p == 0.0 && q == 0.0 && r == 0.0 && s == 0.0) continue;
                double *restrict onto = matrix + (long)i * size;
                for (int these = 0; these <= those; these++) {
                    const int last = these < those ? to[these] : i + 1;
                    for (int j = from[these]; j < last; j++)
                        onto[j] -= p * rows[0][j] + q * rows[1][j] + r * rows[2][j] + s * rows[3][j];
                }
            }
    }
    return 1;
}

/* Solve L^T y = x in place, for a lower triangle L (size, size); x is zero from `count` on. */
INLINE void backward(const double *lower, int size, int count, double *x) {
    for (int k = count - 1; k >= 0; k--) {
        if (x[k] == 0.0) continue;
        const double *row = lower + (long)k * size;
        x[k] /= row[k];
        less(x, row, x[k], k);
    }
}

/* Compute x = -(H + damping 1)^-1 g by Cholesky decomposition, and x (H + damping 1)^-1 x; return 0 if it is not
 * positive definite. `lower` (size, size) and `room` (size,) are overwritten. */
FOR_EACH_PROCESSOR static int damped(
    const double *hessian, const double *gradient, int size, double damping, double *lower, double *room, double *x,
    double *bend) {
    memcpy(lower, hessian, sizeof(double) * size * size);
    for (int k = 0; k < size; k++) lower[(long)k * size + k] += damping;
    if (!factored(lower, size)) return 0;
    for (int k = 0; k < size; k++) x[k] = -gradient[k];
    backward(lower, size, size, x);
    for (int k = 0; k < size; k++) {
        const double *row = lower + (long)k * size;
        x[k] = (x[k] - dot(row, x, k)) / row[k];
    }
    memcpy(room, x, sizeof(double) * size);
    backward(lower, size, size, room);
    *bend = dot(room, room, size);
    return 1;
}

/* Compute R (count, size) with R R^T the first block of the inverse of `lower` (size, size), which is overwritten, and
 * the logarithm of its determinant; return 0 if it is not positive definite. */
FOR_EACH_PROCESSOR static int roots(double *lower, int size, int count, double *result, double *volume) {
    if (!factored(lower, size)) return 0;
    *volume = 0.0;
    for (int k = 0; k < size; k++) *volume += 2.0 * log(lower[(long)k * size + k]);
    memset(result, 0, sizeof(double) * count * size);
    for (int k = 0; k < count; k++) result[(long)k * size + k] = 1.0;
    for (int k = count - 1; k >= 0; k--) {
        const double *row = lower + (long)k * size;
        int from[STRETCHES], to[STRETCHES];
        const int some = stretches(&row, 1, k, from, to);
        for (int i = k; i < count; i++) {
            double *x = result + (long)i * size;
            if (x[k] == 0.0) continue;
            x[k] /= row[k];
            for (int at = 0; at < some; at++) less(x + from[at], row + from[at], x[k], to[at] - from[at]);
        }
    }
    return 1;
}

/* Find the minimiser of the quadratic model in a ball (see solvers.py); return its length. */
static double minimiser(const State *at, int size, double radius, double *factor, double *room, double *x, double *best) {
    const double nearly = 0.99, close = 1e-10;
    const double steepest = sqrt(dot(at->gradient, at->gradient, size)) / radius;
    const double largest = sqrt(dot(at->hessian, at->hessian, size * size));
    const double smallest = 1e-13 * (largest > steepest ? largest : steepest);
    double low = 0.0, high = INFINITY, damping = 0.0, found = -1.0, bend;
    while (found < 0.0 || high - (low > smallest ? low : smallest) > close * high) {
        const int definite = damped(at->hessian, at->gradient, size, damping, factor, room, x, &bend);
        const double length = definite ? sqrt(dot(x, x, size)) : INFINITY;
        if (length <= radius) {
            high = damping;
            found = length;
            memcpy(best, x, sizeof(double) * size);
            if (damping == 0.0 || !(0.0 < length && length < nearly * radius)) break;
        } else
            low = damping;
        if (definite) damping += length * length / bend * (length / (0.5 * (1.0 + nearly) * radius) - 1.0);
        if (!definite || !(low < damping && damping < high)) {
            const double least = low > smallest ? low : smallest;
            damping = found >= 0.0 ? sqrt(least * high) : 10.0 * least;
        }
    }
    return found;
}

enum { UNFINISHED, FLAT, SETTLED, ROUNDED, INFINITE };

/* Minimise by Newton steps in a trust region, as in solvers.py, from states[0] to states[*end]. `limits`: largest final
 * norm of the gradient, first radius, and least decrease. */
static int descend(
    const Profile *profile, State states[2], const double *limits, int most, double *values, int *steps, int *end,
    double *factor, double *room, double *x, double *tangent) {
    const int size = profile->problem.size;
    double radius = limits[1];
    State *at = states, *trial = states + 1;
    evaluate(profile, at);
    if (!is_finite(at, size)) return INFINITE;
    values[0] = at->value;
    for (*steps = 0; *steps < most; values[++*steps] = at->value) {
        const double steep = sqrt(dot(at->gradient, at->gradient, size));
        double ratio, length;
        *end = (int)(at - states);
        if (steep <= limits[0]) return FLAT;
        for (;;) {
            length = minimiser(at, size, radius, factor, room, x, tangent);
            double predicted = -dot(at->gradient, tangent, size);
            for (int k = 0; k < size; k++)
                predicted -= 0.5 * tangent[k] * dot(at->hessian + (long)k * size, tangent, size);
            if (predicted < limits[2] && length < radius) return SETTLED;
            stepped(&profile->problem, at, tangent, trial);
            evaluate(profile, trial);
            const int finite = is_finite(trial, size);
            ratio = finite ? (at->value - trial->value) / predicted : -INFINITY;
            if (ratio >= 1e-4) break;
            if (finite && predicted <= 1e-10 * at->value &&
                sqrt(dot(trial->gradient, trial->gradient, size)) <= 0.5 * steep) {
                ratio = 1.0;
                break;
            }
            if (predicted <= 1e-13 * at->value || length < 1e-12) return ROUNDED;
            radius = 0.25 * length;
        }
        if (ratio < 0.25)
            radius = 0.25 * length;
        else if (ratio > 0.75 && length >= 0.99 * radius)
            radius *= 2.0;
        State *before = at;
        at = trial;
        trial = before;
    }
    *end = (int)(at - states);
    return UNFINISHED;
}

PyObject *native_straight_lines(PyObject *module, PyObject *arguments) {
    Py_buffer base, steps, ends;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "y*y*w*", &base, &steps, &ends)) return NULL;
    straight_lines(base.buf, steps.buf, (int)(ends.len / (16 * sizeof(double))), ends.buf);
    release(3, (Py_buffer *[]){&base, &steps, &ends});
    Py_RETURN_NONE;
}

PyObject *native_second_order(PyObject *module, PyObject *arguments) {
    Py_buffer basis, bases, inertias, priors, rest, prior_rest, scales, weights, slope, products, pull, known;
    Py_buffer gradient, information, hessian;
    (void)module;
    if (!PyArg_ParseTuple(
            arguments, "y*y*y*y*y*y*y*y*y*y*y*y*w*w*w*", &basis, &bases, &inertias, &priors, &rest, &prior_rest,
            &scales, &weights, &slope, &products, &pull, &known, &gradient, &information, &hessian))
        return NULL;
    Problem problem = {
        .links = (int)(inertias.len / (16 * sizeof(double))),
        .positives = (int)((rest.len - scales.len) / sizeof(double)),
        .size = (int)(weights.len / sizeof(double)),
        .inertias = inertias.buf,
        .priors = priors.buf,
        .rest = rest.buf,
        .prior_rest = prior_rest.buf,
        .scales = scales.buf,
        .weights = weights.buf,
        .rows = {{basis.buf, slope.buf, products.buf, 0}, {bases.buf, pull.buf, known.buf, 100}},
        .gradient = gradient.buf,
        .information = information.buf,
        .hessian = hessian.buf,
    };
    problem.terms = PyMem_Malloc((problem.links + 1) * sizeof(Link));
    const double value = problem.terms ? second_order(&problem) : 0.0;
    const int failed = problem.terms == NULL;
    PyMem_Free(problem.terms);
    release(
        15, (Py_buffer *[]){
                &basis, &bases, &inertias, &priors, &rest, &prior_rest, &scales, &weights, &slope, &products, &pull,
                &known, &gradient, &information, &hessian});
    return failed ? PyErr_NoMemory() : PyFloat_FromDouble(value);
}

PyObject *native_weigh(PyObject *module, PyObject *arguments) {
    Py_buffer products, widths, rows, places, runs, ends, vector, counts, least, squares, total;
    (void)module;
    if (!PyArg_ParseTuple(
            arguments, "y*y*y*y*y*y*y*y*y*w*w*", &products, &widths, &rows, &places, &runs, &ends, &vector, &counts,
            &least, &squares, &total))
        return NULL;
    const Packed packed = {products.buf, widths.buf, rows.buf, places.buf, runs.buf, ends.buf};
    double *own = PyMem_Malloc(vector.len);
    if (own)
        weigh(
            &packed, vector.buf, counts.buf, least.buf, (int)(counts.len / sizeof(double)),
            (int)(vector.len / sizeof(double)), own, squares.buf, total.len ? total.buf : NULL);
    const int failed = own == NULL;
    PyMem_Free(own);
    release(
        11, (Py_buffer *[]){
                &products, &widths, &rows, &places, &runs, &ends, &vector, &counts, &least, &squares, &total});
    if (failed) return PyErr_NoMemory();
    Py_RETURN_NONE;
}

PyObject *native_damped(PyObject *module, PyObject *arguments) {
    Py_buffer hessian, gradient, step;
    double damping, bend = 0.0;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "y*y*dw*", &hessian, &gradient, &damping, &step)) return NULL;
    const int size = (int)(step.len / sizeof(double));
    double *room = PyMem_Malloc(hessian.len + step.len);
    const int failed = room == NULL;
    if (room && !damped(hessian.buf, gradient.buf, size, damping, room, room + (long)size * size, step.buf, &bend)) bend = -1.0;
    PyMem_Free(room);
    release(3, (Py_buffer *[]){&hessian, &gradient, &step});
    return failed ? PyErr_NoMemory() : PyFloat_FromDouble(bend);
}

PyObject *native_roots(PyObject *module, PyObject *arguments) {
    Py_buffer matrix, result;
    double volume = 0.0;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "w*w*", &matrix, &result)) return NULL;
    const int size = (int)sqrt(matrix.len / sizeof(double) + 0.5);
    const int count = size ? (int)(result.len / (sizeof(double) * size)) : 0;
    const int definite = roots(matrix.buf, size, count, result.buf, &volume);
    release(2, (Py_buffer *[]){&matrix, &result});
    return Py_BuildValue("id", definite, volume);
}

PyObject *native_descend(PyObject *module, PyObject *arguments) {
    Py_buffer basis, bases, priors, prior_rest, scales, weights, products, widths, rows, places, runs, ends;
    Py_buffer counts, least, known, limits, inertias, rest, gradient, information, hessian, values;
    (void)module;
    if (!PyArg_ParseTuple(
            arguments, "y*y*y*y*y*y*y*y*y*y*y*y*y*y*y*y*w*w*w*w*w*w*", &basis, &bases, &priors, &prior_rest, &scales,
            &weights, &products, &widths, &rows, &places, &runs, &ends, &counts, &least, &known, &limits, &inertias, &rest,
            &gradient, &information, &hessian, &values))
        return NULL;
    const int size = (int)(weights.len / sizeof(double)), channels = (int)(counts.len / sizeof(double));
    const long square = (long)size * size, stride = size + 1;
    Profile profile = {
        .problem =
            {.links = (int)(priors.len / (16 * sizeof(double))),
             .size = size,
             .priors = priors.buf,
             .prior_rest = prior_rest.buf,
             .scales = scales.buf,
             .weights = weights.buf},
        .channels = channels,
        .packed = {products.buf, widths.buf, rows.buf, places.buf, runs.buf, ends.buf},
        .counts = counts.buf,
        .least = least.buf,
    };
    double *room = PyMem_Malloc(sizeof(double) * (3 * square + stride * stride + 9 * stride + 16 * stride + channels));
    Link *terms = PyMem_Malloc((profile.problem.links + 1) * sizeof(Link));
    int steps = 0, end = 0, reason = UNFINISHED;
    if (room && terms) {
        double *next = room;
#define TAKE(count) (next += (count), next - (count))
        State states[2] = {
            {0.0, inertias.buf, rest.buf, gradient.buf, information.buf, hessian.buf},
            {0.0, TAKE(16 * profile.problem.links), TAKE(stride), TAKE(stride), TAKE(square), TAKE(square)}};
        double *factor = TAKE(square), *other = TAKE(stride), *x = TAKE(stride), *tangent = TAKE(stride);
        profile.vector = TAKE(stride);
        profile.off = TAKE(stride);
        profile.slope = TAKE(stride);
        profile.pull = TAKE(stride);
        profile.total = TAKE(stride * stride);
        profile.squares = TAKE(channels);
        profile.problem.rows[MEASURED] = (Rows){basis.buf, profile.slope, profile.total, 0};
        profile.problem.rows[KNOWN] = (Rows){bases.buf, profile.pull, known.buf, 100};
        profile.problem.terms = terms;
        Py_BEGIN_ALLOW_THREADS
        reason = descend(
            &profile, states, limits.buf, (int)(values.len / sizeof(double)) - 1, values.buf, &steps, &end, factor, other,
            x, tangent);
        Py_END_ALLOW_THREADS
        if (end) {
            memcpy(inertias.buf, states[1].inertias, inertias.len);
            memcpy(rest.buf, states[1].rest, rest.len);
            memcpy(gradient.buf, states[1].gradient, gradient.len);
            memcpy(information.buf, states[1].information, information.len);
            memcpy(hessian.buf, states[1].hessian, hessian.len);
        }
    }
    const int failed = !(room && terms);
    PyMem_Free(room);
    PyMem_Free(terms);
    release(
        22, (Py_buffer *[]){
                &basis, &bases, &priors, &prior_rest, &scales, &weights, &products, &widths, &rows, &places, &runs, &ends,
                &counts, &least, &known, &limits, &inertias, &rest, &gradient, &information, &hessian, &values});
    return failed ? PyErr_NoMemory() : Py_BuildValue("ii", reason, steps);
}
