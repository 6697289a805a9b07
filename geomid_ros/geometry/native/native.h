/* Functions of the module, and shared code. Arguments are contiguous buffers of doubles (indices: of 64-bit integers);
 * the callers in Python ensure that their shapes match. */
#ifndef GEOMID_NATIVE_H
#define GEOMID_NATIVE_H

static inline void release(int count, Py_buffer **buffers) {
    for (int k = 0; k < count; k++) PyBuffer_Release(buffers[k]);
}

PyObject *native_damped(PyObject *module, PyObject *arguments);
PyObject *native_descend(PyObject *module, PyObject *arguments);
PyObject *native_eigenvectors(PyObject *module, PyObject *arguments);
PyObject *native_measure(PyObject *module, PyObject *arguments);
PyObject *native_project(PyObject *module, PyObject *arguments);
PyObject *native_roots(PyObject *module, PyObject *arguments);
PyObject *native_second_order(PyObject *module, PyObject *arguments);
PyObject *native_straight_lines(PyObject *module, PyObject *arguments);
PyObject *native_weigh(PyObject *module, PyObject *arguments);

#endif
