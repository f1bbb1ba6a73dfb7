//! Charts as pixels and as PNG.

use crate::chart::Chart;
use crate::draw;
use anyhow::{Context, Result};
use std::io::Write;

impl Chart {
    /// Draws the panels; three bytes a pixel, rows from top to bottom.
    ///
    /// # Errors
    /// A panel without a range of x has nothing that its axes can show.
    pub fn pixels(&self) -> Result<Vec<u8>> {
        draw::pixels(self).with_context(|| format!("cannot draw `{}`", self.title))
    }

    /// Draws the panels and writes them as PNG.
    ///
    /// # Errors
    /// As [`Self::pixels`], or the bytes cannot be written.
    pub fn write(&self, into: impl Write) -> Result<()> {
        let pixels = self.pixels()?;
        let (width, height) = self.size();
        let mut encoder = png::Encoder::new(into, width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header().context("cannot write the picture")?;
        writer.write_image_data(&pixels).context("cannot write the picture")?;
        writer.finish().context("cannot write the picture")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Band, Panel, linear, log};

    fn panel(points: Vec<(f64, f64)>) -> Panel {
        Panel::new("test", log("x, m"), linear("y")).line("one", points.clone()).bound("bar", points)
    }

    /// Pixels that differ between two charts of one size.
    fn changed(one: &Chart, other: &Chart) -> usize {
        let (one, other) = (one.pixels().unwrap(), other.pixels().unwrap());
        one.chunks(3).zip(other.chunks(3)).filter(|(one, other)| one != other).count()
    }

    #[test]
    fn a_chart_has_its_size_and_ink_and_an_empty_one_is_an_error() {
        let chart = Chart::grid("title", vec![panel(vec![(1.0, 2.0), (100.0, 3.0)])]);
        let mut file = Vec::new();
        chart.write(&mut file).unwrap();
        let mut decoded = png::Decoder::new(std::io::Cursor::new(file)).read_info().unwrap();
        assert_eq!((decoded.info().width, decoded.info().height), (860, 724));
        let mut pixels = vec![0; decoded.output_buffer_size().unwrap()];
        decoded.next_frame(&mut pixels).unwrap();
        assert_eq!(pixels, chart.pixels().unwrap());
        let ink = pixels.chunks_exact(3).filter(|pixel| *pixel != [255; 3]).count();
        assert!(ink > 5_000, "{ink}");
        let empty = Chart::grid("title", vec![panel(vec![(-1.0, 2.0)])]).pixels().unwrap_err();
        assert!(format!("{empty:#}").contains("nothing to show"), "{empty:#}");
    }

    #[test]
    fn panels_over_a_range_may_be_empty_and_have_gaps_and_bands() {
        let values = |at: f64| (0..10).map(move |x| (f64::from(x), if x == 5 { at } else { 3.0 }));
        let traced = |at: f64| {
            let panel = Panel::new("test", linear("s"), linear("y")).over(0.0..10.0).from_zero();
            Chart::column("title", "subtitle", vec![panel.trace("one", values(at))])
        };
        let empty = Panel::new("test", linear("s"), log("ms")).over(0.0..10.0);
        let empty = Chart::column("title", "subtitle", vec![empty]);
        assert!(empty.pixels().is_ok());
        assert_eq!(traced(3.0).size(), (1280, 492));
        let gap = changed(&traced(3.0), &traced(f64::NAN));
        // Two seconds of ten of a line of 2 pixels across some 1,100.
        assert!((200..2_000).contains(&gap), "{gap}");
        assert_eq!(changed(&traced(3.0), &traced(3.0)), 0, "the control");
        let mut banded = traced(3.0);
        banded.panels[0].bands = vec![Band { name: "warm-up".into(), range: 0.0..4.0 }];
        assert!(changed(&banded, &traced(3.0)) > 50_000);
    }
}
