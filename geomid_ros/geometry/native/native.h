/* The functions of the module, and what they share. Arguments are contiguous buffers of doubles (places: of 64-bit
 * integers) whose shapes the callers in Python have made fit each other. */
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
