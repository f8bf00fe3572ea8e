//! Two views: essential matrix, Sampson distance, Plücker rays.
