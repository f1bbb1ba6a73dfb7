//! Waves: the tiers of parallax against the marched truth.

use super::Curve;
use anyhow::{Result, bail};

/// Measures it.
///
/// # Errors
/// Not built yet.
pub fn measure(_: u64) -> Result<Curve> {
    bail!("not measured yet")
}
