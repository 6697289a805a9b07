/* Projection of a point on many hyperplanes; see projection.py for the formulas and the notation. */
#include <Python.h>

#include "native.h"

#include "lanes.h"

enum { FOUND, NONE_LOW, NONE_HIGH };

#define MOST_STEPS 100
#define DEGREE 28
#define TOGETHER 4 /* lanes per group: a link's eigenvalues; positive coefficients are padded to groups */

static const double E = 2.71828182845904523536, NEAR = 3.0 / 2.71828182845904523536;
static const double NOISE = 1e-14, RELATIVE_TOLERANCE = 1e-14, BRANCH_GAP = 1e-9, CLOSE = -0.3659;

typedef struct {
    Eigen eigen;
    Lane basis[10][10]; /* coordinates of v_k v_k^T and (v_k v_m^T + v_m v_k^T) / sqrt(2) of the eigenvectors */
    Lane sums[10][10];  /* of the rows' curvatures; upper triangle */
} Block;

/* One row: eigenvalues s in lanes, for each block that it touches, then the positive coefficients; W(L s) and s exp(-W)
 * of each; and the other terms of C(L). */
typedef struct {
    int groups;
    Lane *values, *lambert, *moved;
    const double *polynomial;
    double low, high; /* ends of the interval of multipliers */
    double flat, offset;
    double total, slope, bend, size; /* C, its derivatives, and the size of its terms */
} Row;

/* Lanes as one array of numbers. */
INLINE double *flat(Lane *lanes) { return (double *)lanes; }

/* Number of lanes, in whole groups, for so many numbers. */
INLINE int groups_of(int numbers) { return (numbers + TOGETHER * LANES - 1) / (TOGETHER * LANES) * TOGETHER; }

/* W of z above NEAR: Halley's iteration (Corless et al., "On the Lambert W function", 1996). */
static double lambert_far(double z) {
    const double logarithm = log1p(z);
    double w = logarithm * (1.0 - log1p(logarithm) / (2.0 + logarithm));
    for (int k = 0; k < 8; k++) {
        const double exponential = exp(w), excess = w * exponential - z, slope = exponential * (w + 1.0);
        const double step = excess / (slope - 0.5 * excess * (w + 2.0) / (w + 1.0));
        w -= step;
        if (fabs(step) <= 1e-15 * (1.0 + fabs(w))) break;
    }
    return w;
}

/* Evaluate C, its derivatives and the size of its terms at a multiplier. */
INLINE void constrain(Row *row, double multiplier) {
    const double inverse = multiplier != 0.0 ? 1.0 / multiplier : 0.0;
    const double one = -multiplier / (E * row->low), other = -multiplier / (E * row->high); /* extremes of L s */
    const int far = fmax(one, other) > NEAR || fmin(one, other) < CLOSE;
    Lane total = {0.0}, size = {0.0}, slope = {0.0}, bend = {0.0};
    for (int first = 0; first < row->groups; first += TOGETHER) {
        double *values = row->values[first], *lambert = row->lambert[first], *moved = row->moved[first];
        double power[TOGETHER * LANES];
        Vector v[TOGETHER], series[TOGETHER];
        for (int i = 0; i < TOGETHER * LANES; i++) {
            const double z = multiplier * values[i], inside = 1.0 + E * z;
            const double shifted = E * z / (1.0 + sqrt(inside > 0.0 ? inside : 0.0));
            power[i] = shifted > -1.0 ? shifted : -1.0;
        }
        for (int k = 0; k < TOGETHER; k++) { /* interleaved, so that none waits for another */
            v[k] = loaded(power + LANES * k);
            series[k] = v[k] * row->polynomial[DEGREE] + row->polynomial[DEGREE - 1];
        }
        for (int degree = DEGREE - 2; degree >= 0; degree--)
            for (int k = 0; k < TOGETHER; k++) series[k] = series[k] * v[k] + row->polynomial[degree];
        for (int k = 0; k < TOGETHER; k++) {
            series[k] *= v[k];
            memcpy(lambert + LANES * k, series + k, sizeof(Vector));
        }
        for (int i = 0; i < TOGETHER * LANES; i++) {
            lambert[i] = lambert[i] > -1.0 ? lambert[i] : -1.0;
            moved[i] = multiplier != 0.0 ? inverse * lambert[i] : values[i];
        }
        if (far)
            for (int i = 0; i < TOGETHER * LANES; i++) {
                const double z = multiplier * values[i];
                if (z > NEAR) {
                    lambert[i] = lambert_far(z);
                    moved[i] = lambert[i] / multiplier;
                } else if (z < CLOSE) { /* near the branch point the exponential is more accurate than W/L */
                    moved[i] = values[i] * exp(-lambert[i]);
                }
            }
        for (int k = 0; k < TOGETHER; k++)
            for (int i = 0; i < LANES; i++) {
                const double w = lambert[LANES * k + i], m = moved[LANES * k + i], gap = 1.0 + w;
                const double steep = m / (gap > BRANCH_GAP ? gap : BRANCH_GAP);
                total[i] += m;
                size[i] += fabs(m);
                slope[i] += m * steep;
                bend[i] += steep * steep * steep * (3.0 + 2.0 * w);
            }
    }
    row->total = row->offset - multiplier * row->flat;
    row->size = fabs(row->offset) + fabs(multiplier * row->flat);
    row->slope = -row->flat;
    row->bend = 0.0;
    for (int i = 0; i < LANES; i++) {
        row->total += total[i];
        row->size += size[i];
        row->slope -= slope[i];
        row->bend += bend[i];
    }
}

/* Compute the interval of multipliers; set eigenvalues to zero that are zero up to rounding. */
INLINE void find_interval(Row *row) {
    double largest = 0.0, smallest = 0.0;
    for (int k = 0; k < LANES * row->groups; k++) {
        const double value = flat(row->values)[k];
        largest = value > largest ? value : largest;
        smallest = value < smallest ? value : smallest;
    }
    const double noise = NOISE * fmax(largest, -smallest);
    for (int k = 0; k < LANES * row->groups; k++)
        if (fabs(flat(row->values)[k]) <= noise) flat(row->values)[k] = 0.0;
    row->low = largest > noise ? -1.0 / (E * largest) : -INFINITY;
    row->high = smallest < -noise ? -1.0 / (E * smallest) : INFINITY;
}

/* Find the root of C by Halley's method inside a shrinking bracket; the row keeps its values there. */
INLINE double find_root(Row *row, int *status) {
    find_interval(row);
    constrain(row, 0.0);
    *status = FOUND;
    if (row->slope == 0.0) {
        if (row->total != 0.0) *status = row->total < 0.0 ? NONE_LOW : NONE_HIGH;
        return 0.0;
    }
    /* If all eigenvalues have one sign and there is no flat direction, C falls to its constant part at infinity. */
    if (row->total > 0.0 && row->high == INFINITY && row->flat == 0.0 && row->offset >= 0.0) *status = NONE_HIGH;
    if (row->total < 0.0 && row->low == -INFINITY && row->flat == 0.0 && row->offset <= 0.0) *status = NONE_LOW;
    if (*status != FOUND) return 0.0;
    const int rising = row->total > 0.0;
    const double end = rising ? row->high : row->low;
    double low = rising ? 0.0 : row->low, high = rising ? row->high : 0.0, multiplier = 0.0;
    int tried = 0;
    for (int step = 0; step < MOST_STEPS && !(fabs(row->total) <= RELATIVE_TOLERANCE * row->size); step++) {
        const double rate = row->slope - 0.5 * row->total * row->bend / row->slope;
        double candidate = multiplier - row->total / (rate < 0.5 * row->slope ? rate : row->slope);
        if (candidate == multiplier) break;
        if (!(low < candidate && candidate < high)) {
            if (!tried && isfinite(end)) {
                constrain(row, end);
                if (row->total != 0.0 && (row->total > 0.0) == rising) {
                    *status = rising ? NONE_HIGH : NONE_LOW;
                    return end;
                }
                tried = 1;
            }
            candidate = 0.5 * (low + high); /* finite: towards an infinite end C is convex, so steps stay inside */
        }
        multiplier = candidate;
        constrain(row, multiplier);
        if (row->total > 0.0)
            low = multiplier;
        else
            high = multiplier;
    }
    return multiplier;
}

/* Compute eigenvalues of a row's X-bar, and eigenvectors of the blocks that it touches; list these in `touched`. */
INLINE void decompose(const double *x, int size, int links, int positives, Block *blocks, int *touched, Row *row) {
    row->groups = 0;
    for (int first = 0; first < links; first += LANES) {
        const int some = links - first < LANES ? links - first : LANES;
        int any = 0;
        for (int k = 10 * first; k < 10 * (first + some); k++) any |= x[k] != 0.0;
        if (!any) continue;
        Eigen *eigen = &blocks[first / LANES].eigen;
        gather_coordinates(x + 10 * first, some, eigen->values);
        diagonalise(eigen);
        memcpy(row->values[row->groups], eigen->values, 4 * sizeof(Lane));
        touched[row->groups / 4] = first / LANES;
        row->groups += 4;
    }
    for (int k = 0; k < LANES * groups_of(positives); k++)
        flat(row->values + row->groups)[k] = k < positives ? x[10 * links + k] : 0.0;
    row->groups += groups_of(positives);
    row->flat = 0.0;
    for (int k = 10 * links + positives; k < size; k++) row->flat += x[k] * x[k];
}

/* Dual function at the multiplier; at a root the excess is zero up to rounding. */
INLINE double half_squared(const Row *row, double multiplier) {
    double half = 0.5 * multiplier * multiplier * row->flat + multiplier * row->total;
    for (int k = 0; k < LANES * row->groups; k++) half += 0.5 * flat(row->lambert)[k] * flat(row->lambert)[k];
    return half;
}

INLINE void make_basis(Block *block) {
    for (int a = 0; a < 10; a++) {
        const int k = ROW[a], m = COLUMN[a];
        for (int b = 0; b < 10; b++) {
            const double scale = 0.5 * (a < 4 ? 1.0 : ROOT_TWO) * (b < 4 ? 1.0 : ROOT_TWO);
            const Lane *r = block->eigen.vectors[ROW[b]], *c = block->eigen.vectors[COLUMN[b]];
            for (int i = 0; i < LANES; i++) block->basis[a][b][i] = scale * (r[k][i] * c[m][i] + r[m][i] * c[k][i]);
        }
    }
}

/* Write the coordinates of sum sizes_k v_k v_k^T of a block's links into result (10 each). */
INLINE void along_eigenvectors(const Block *block, Lane *sizes, int some, double *result) {
    for (int b = 0; b < 10; b++) {
        Lane sum;
        for (int i = 0; i < LANES; i++)
            sum[i] = sizes[0][i] * block->basis[0][b][i] + sizes[1][i] * block->basis[1][b][i] +
                     sizes[2][i] * block->basis[2][b][i] + sizes[3][i] * block->basis[3][b][i];
        for (int i = 0; i < some; i++) result[10 * i + b] = sum[i];
    }
}

/* (s_k + s_l)(W_k - W_l) / (2 (s_k - s_l)) with its limit for equal eigenvalues, times the weight. */
INLINE void pair_curvatures(Lane *values, Lane *lambert, double weight, Lane bends[10]) {
    for (int a = 0; a < 10; a++)
        for (int i = 0; i < LANES; i++) {
            const double s = values[ROW[a]][i], t = values[COLUMN[a]][i];
            const double w = lambert[ROW[a]][i], u = lambert[COLUMN[a]][i], middle = 0.5 * (w + u);
            const int apart = fabs(s - t) > 1e-7 * (fabs(s) + fabs(t));
            const int above = middle > -1.0; /* else a kink: two extreme eigenvalues beyond the end */
            const double limit = above ? middle : 0.0, divisor = above ? 1.0 + middle : 1.0;
            bends[a][i] = weight * (apart ? 0.5 * (s + t) * (w - u) : limit) / (apart ? s - t : divisor);
        }
}

INLINE void add_curvature(Block *block, Lane bends[10]) {
    for (int r = 0; r < 10; r++) {
        Vector bent[10];
        for (int a = 0; a < 10; a++) bent[a] = loaded(bends[a]) * loaded(block->basis[a][r]);
        for (int c = r; c < 10; c++) {
            Vector sum = loaded(block->sums[r][c]);
            for (int a = 0; a < 10; a++) sum += bent[a] * loaded(block->basis[a][c]);
            memcpy(block->sums[r][c], &sum, sizeof sum);
        }
    }
}

typedef struct {
    int rows, size, links, positives;
    const double *normals, *offsets, *weights, *polynomial; /* (N, D), (N,), (N,) */
    double *halves, *tangent, *direction, *curvature;       /* (N,), (N, D), (N, D), (D, D): its upper triangle */
    long long *status;                                      /* (N,) */
    Block *blocks;
    int *touched;
    Lane *room;    /* five times most_groups */
    double *moves; /* two vectors (D,) */
} Task;

INLINE int most_groups(const Task *task) {
    return groups_of(4 * task->links) + groups_of(task->positives);
}

/* Return the multiplier of a row; store its half squared distance and its status. Both functions below call this code,
 * because rounding would differ if it were compiled into each. */
FOR_EACH_PROCESSOR static double solve(const Task *task, int index, Row *row) {
    const int most = most_groups(task);
    int status;
    row->values = task->room;
    row->lambert = task->room + most;
    row->moved = task->room + 2 * most;
    row->polynomial = task->polynomial;
    row->offset = task->offsets[index];
    decompose(
        task->normals + (long)index * task->size, task->size, task->links, task->positives, task->blocks, task->touched,
        row);
    const double multiplier = find_root(row, &status);
    task->status[index] = status;
    task->halves[index] = half_squared(row, multiplier);
    return multiplier;
}

static void measure(const Task *task) {
    Row row;
    for (int index = 0; index < task->rows; index++) solve(task, index, &row);
}

/* Add the part of the Hessian due to the end of the interval, which moves with the extreme eigenvalue. */
INLINE void bend_with_the_end(const Task *task, const Row *row, const double *x, int extreme, double multiplier, double weight) {
    const int size = task->size, links = task->links, inertial = 10 * links;
    const int in_links = row->groups - groups_of(task->positives);
    double *mover = task->moves, *others = task->moves + size, own = 1.0 + multiplier * row->total;
    memset(mover, 0, 2 * sizeof(double) * size);
    for (int k = 0; k < LANES * row->groups; k++) {
        const double w = flat(row->lambert)[k], bend = k != extreme ? w / (1.0 + w) : 0.0;
        own -= w * bend;
        const int group = k / LANES, lane = k % LANES;
        if (group < in_links) {
            const int block = task->touched[group / 4], link = LANES * block + lane;
            if (link >= links) continue;
            for (int b = 0; b < 10; b++) {
                const double unit = task->blocks[block].basis[group % 4][b][lane];
                if (k == extreme)
                    mover[10 * link + b] = unit;
                else
                    others[10 * link + b] += bend * unit;
            }
        } else {
            const int place = LANES * (group - in_links) + lane;
            if (place >= task->positives) continue;
            if (k == extreme)
                mover[inertial + place] = 1.0;
            else
                others[inertial + place] += bend;
        }
    }
    for (int k = inertial + task->positives; k < size; k++) {
        others[k] = multiplier * x[k];
        own -= others[k] * others[k];
    }
    for (int r = 0; r < size; r++)
        for (int c = r; c < size; c++)
            task->curvature[(long)r * size + c] +=
                weight * (own * mover[r] * mover[c] - mover[r] * others[c] - others[r] * mover[c]);
}

FOR_EACH_PROCESSOR static void project(const Task *task) {
    const int size = task->size, links = task->links, positives = task->positives, most = most_groups(task);
    for (int index = 0; index < task->rows; index++) {
        const double *x = task->normals + (long)index * size;
        double *tangent = task->tangent + (long)index * size, *direction = task->direction + (long)index * size;
        const double weight = task->weights[index];
        Row row;
        const double multiplier = solve(task, index, &row), excess = row.total;
        const int status = (int)task->status[index];
        Lane *toward = task->room + 3 * most, *along = task->room + 4 * most;
        double steepness = row.flat;
        int extreme = 0;
        for (int k = 0; k < LANES * row.groups; k++) {
            const double w = flat(row.lambert)[k];
            flat(toward)[k] = -w;
            /* One bound in both parts of the Hessian, so that their infinities cancel. */
            flat(row.lambert)[k] = w > BRANCH_GAP - 1.0 ? w : BRANCH_GAP - 1.0;
            flat(along)[k] = flat(row.moved)[k] / (1.0 + flat(row.lambert)[k]);
            steepness += flat(along)[k] * flat(row.moved)[k];
            if (multiplier * flat(row.values)[k] < multiplier * flat(row.values)[extreme]) extreme = k;
        }
        if (status != FOUND && row.groups) {
            flat(toward)[extreme] += multiplier * excess;
            flat(row.lambert)[extreme] -= multiplier * excess; /* negative gradient, for curvatures between pairs */
        }
        const int beyond = status != FOUND && multiplier != 0.0;
        const double share = status == FOUND && steepness > 0.0 ? 1.0 / sqrt(steepness) : 0.0;
        for (int k = 0; k < LANES * row.groups; k++) flat(along)[k] *= share;
        const int in_links = row.groups - groups_of(positives);
        for (int group = 0; group < in_links; group += 4) {
            const int first = LANES * task->touched[group / 4], some = links - first < LANES ? links - first : LANES;
            Block *block = task->blocks + task->touched[group / 4];
            Lane bends[10];
            make_basis(block);
            along_eigenvectors(block, toward + group, some, tangent + 10 * first);
            along_eigenvectors(block, along + group, some, direction + 10 * first);
            pair_curvatures(row.values + group, row.lambert + group, weight, bends);
            if (beyond && extreme / LANES >= group && extreme / LANES < group + 4)
                bends[extreme / LANES - group][extreme % LANES] = 0.0;
            add_curvature(block, bends);
        }
        for (int k = 0; k < positives; k++) {
            const int place = LANES * in_links + k, column = 10 * links + k;
            const double w = flat(row.lambert)[place];
            tangent[column] = flat(toward)[place];
            direction[column] = flat(along)[place];
            if (!(beyond && extreme == place))
                task->curvature[(long)column * size + column] += weight * w / (1.0 + w);
        }
        for (int k = 10 * links + positives; k < size; k++) {
            tangent[k] = -multiplier * x[k];
            direction[k] = share * x[k];
        }
        if (beyond && weight != 0.0) bend_with_the_end(task, &row, x, extreme, multiplier, weight);
    }
    for (int link = 0; link < links; link++)
        for (int r = 0; r < 10; r++)
            for (int c = r; c < 10; c++)
                task->curvature[(long)(10 * link + r) * size + 10 * link + c] +=
                    task->blocks[link / LANES].sums[r][c][link % LANES];
}

/* Allocate a task's buffers and run the work without Python's lock; return 0 if memory is lacking. */
static int run(Task *task, void (*work)(const Task *)) {
    const int blocks = (task->links + LANES - 1) / LANES;
    task->blocks = PyMem_Calloc(blocks + 1, sizeof(Block));
    task->touched = PyMem_Calloc(blocks + 1, sizeof(int));
    task->room = PyMem_Calloc(5 * most_groups(task) + 1, sizeof(Lane));
    task->moves = PyMem_Calloc(2 * task->size + 1, sizeof(double));
    const int ready = task->blocks && task->touched && task->room && task->moves;
    if (ready) {
        Py_BEGIN_ALLOW_THREADS
        work(task);
        Py_END_ALLOW_THREADS
    }
    PyMem_Free(task->blocks);
    PyMem_Free(task->touched);
    PyMem_Free(task->room);
    PyMem_Free(task->moves);
    return ready;
}

static Task task_of(const Py_buffer *normals, const Py_buffer *offsets, const Py_buffer *polynomial, int links, int positives) {
    const int rows = (int)(offsets->len / sizeof(double));
    Task task = {
        .rows = rows,
        .size = rows ? (int)(normals->len / sizeof(double) / rows) : 0,
        .links = links,
        .positives = positives,
        .normals = normals->buf,
        .offsets = offsets->buf,
        .polynomial = polynomial->buf,
    };
    return task;
}

PyObject *native_measure(PyObject *module, PyObject *arguments) {
    Py_buffer normals, offsets, polynomial, halves, status;
    int links, positives;
    (void)module;
    if (!PyArg_ParseTuple(
            arguments, "y*y*y*iiw*w*", &normals, &offsets, &polynomial, &links, &positives, &halves, &status))
        return NULL;
    Task task = task_of(&normals, &offsets, &polynomial, links, positives);
    task.halves = halves.buf;
    task.status = status.buf;
    const int done = run(&task, measure);
    release(5, (Py_buffer *[]){&normals, &offsets, &polynomial, &halves, &status});
    if (!done) return PyErr_NoMemory();
    Py_RETURN_NONE;
}

PyObject *native_project(PyObject *module, PyObject *arguments) {
    Py_buffer normals, offsets, polynomial, weights, halves, tangent, direction, curvature, status;
    int links, positives;
    (void)module;
    if (!PyArg_ParseTuple(
            arguments, "y*y*y*iiy*w*w*w*w*w*", &normals, &offsets, &polynomial, &links, &positives, &weights, &halves,
            &tangent, &direction, &curvature, &status))
        return NULL;
    Task task = task_of(&normals, &offsets, &polynomial, links, positives);
    task.weights = weights.buf;
    task.halves = halves.buf;
    task.tangent = tangent.buf;
    task.direction = direction.buf;
    task.curvature = curvature.buf;
    task.status = status.buf;
    const int done = run(&task, project);
    release(
        9, (Py_buffer *[]){
               &normals, &offsets, &polynomial, &weights, &halves, &tangent, &direction, &curvature, &status});
    if (!done) return PyErr_NoMemory();
    Py_RETURN_NONE;
}

FOR_EACH_PROCESSOR static void decompose_all(const double *matrices, int count, double *values, double *vectors) {
    Eigen eigen;
    gather(matrices, count, eigen.values);
    diagonalise(&eigen);
    for (int i = 0; i < count; i++)
        for (int r = 0; r < 4; r++) {
            values[4 * i + r] = eigen.values[r][i];
            for (int c = 0; c < 4; c++) vectors[16 * i + 4 * r + c] = eigen.vectors[r][c][i];
        }
}

PyObject *native_eigenvectors(PyObject *module, PyObject *arguments) {
    Py_buffer matrices, values, vectors;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "y*w*w*", &matrices, &values, &vectors)) return NULL;
    const int count = (int)(matrices.len / (16 * sizeof(double)));
    decompose_all(matrices.buf, count < LANES ? count : LANES, values.buf, vectors.buf);
    release(3, (Py_buffer *[]){&matrices, &values, &vectors});
    Py_RETURN_NONE;
}
