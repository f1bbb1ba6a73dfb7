//! A picture of several panels under one title.

use crate::Panel;

/// Panels under one title, from left to right and from top to bottom.
#[derive(Clone, Debug)]
pub struct Chart {
    /// Above all panels.
    pub title: String,
    /// A second line under the title; none if empty.
    pub subtitle: String,
    /// The diagrams.
    pub panels: Vec<Panel>,
    /// Panels in a row, at least 1.
    pub columns: usize,
    /// Width and height of a panel, pixels.
    pub panel: (u32, u32),
}

impl Chart {
    /// Panels of 860 x 660 pixels, two in a row.
    pub fn grid(title: impl Into<String>, panels: Vec<Panel>) -> Self {
        let columns = panels.len().clamp(1, 2);
        Self { title: title.into(), subtitle: String::new(), panels, columns, panel: (860, 660) }
    }

    /// Panels of 1280 x 400 pixels below each other.
    pub fn column(title: impl Into<String>, subtitle: impl Into<String>, panels: Vec<Panel>) -> Self {
        let (title, subtitle) = (title.into(), subtitle.into());
        Self { title, subtitle, panels, columns: 1, panel: (1280, 400) }
    }

    /// Width and height, pixels.
    pub fn size(&self) -> (u32, u32) {
        let rows = self.panels.len().div_ceil(self.columns).max(1);
        (self.panel.0 * self.columns as u32, self.panel.1 * rows as u32 + self.head())
    }

    /// Pixels above the panels for the title.
    pub(crate) const fn head(&self) -> u32 {
        if self.subtitle.is_empty() { 64 } else { 92 }
    }
}
