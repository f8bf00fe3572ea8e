//! Points from several views, linear.
