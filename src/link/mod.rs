//! Where coefficients go.
