//! Settings of the window that the panel edits.

use super::clock::Day;
use crate::settings::RenderSettings;

/// Settings that the panel edits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewSettings {
    /// Tolerated screen error, pixels.
    pub tolerance_px: f64,
    /// View distance, metres.
    pub view_distance_m: u32,
    /// Render settings.
    pub render: RenderSettings,
    /// Time of day.
    pub day: Day,
}
