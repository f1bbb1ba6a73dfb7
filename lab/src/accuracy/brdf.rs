//! Reflection: the visibility term and the precision against f64.

use super::Curve;
use anyhow::{Result, bail};

/// Measures it.
///
/// # Errors
/// Not built yet.
pub fn measure(_: u64) -> Result<Curve> {
    bail!("not measured yet")
}
