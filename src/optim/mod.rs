//! Least squares that knows no cameras and no bodies.
