/* geomid_ros.geometry._native: the inner loops of the fits, compiled. */
#include <Python.h>

#include "native.h"

static PyMethodDef methods[] = {
    {"damped", native_damped, METH_VARARGS, "A damped Newton step, and how the inverse bends along it."},
    {"descend", native_descend, METH_VARARGS, "The minimum of a profile objective, by Newton's steps in a trust region."},
    {"eigenvectors", native_eigenvectors, METH_VARARGS, "Eigenvalues and eigenvectors of up to eight 4x4 matrices."},
    {"measure", native_measure, METH_VARARGS, "Half the squared distances to hyperplanes."},
    {"project", native_project, METH_VARARGS, "The same to second order."},
    {"roots", native_roots, METH_VARARGS, "Rows of a root of a definite matrix's inverse, and its log determinant."},
    {"second_order", native_second_order, METH_VARARGS, "Half a squared distance, with rows' products, to second order."},
    {"straight_lines", native_straight_lines, METH_VARARGS, "Pseudo-inertias at the ends of straight lines."},
    {"weigh", native_weigh, METH_VARARGS, "Channels' sums of squares and the weighted sum of their products."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    .m_base = PyModuleDef_HEAD_INIT, .m_name = "_native", .m_size = 0, .m_methods = methods};

PyMODINIT_FUNC PyInit__native(void) { return PyModule_Create(&definition); }
