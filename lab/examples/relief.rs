//! Draws shaded relief of world 0 at three scales, for docs/heightfield.md.
//!
//! Light from the north-west, as on a printed map. Plain Lambert shading of the drawn triangles' vertices, nothing smoothed: a
//! lattice line, a stair or a seam would show as a straight edge.
//!
//! Run: `cargo run --release --example relief -- docs/images`

use anyhow::{Context, Result};
use image::{Rgb, RgbImage};
use std::path::PathBuf;
use terrain::{Grid, Land};

/// Vertices along one side of a picture, one pixel each.
const SIDE: usize = 640;

/// Stem, low corner in metres, level (2 m times 2 to the level per pixel).
const VIEWS: [(&str, (i32, i32), u8); 3] = [
    ("relief-near", (-900, 300), 0),
    ("relief-island", (-5_120, -5_120), 3),
    ("relief-archipelago", (-40_960, -40_960), 6),
];

fn main() -> Result<()> {
    let folder: PathBuf = std::env::args_os().nth(1).context("name the folder to write to")?.into();
    let land = Land::new(0);
    for (stem, (x, z), level) in VIEWS {
        // One more vertex each way: a slope needs a neighbour.
        let grid = Grid::new(x * 256, z * 256, level, SIDE + 1, SIDE + 1)?;
        let mut heights = vec![0; grid.vertex_count()];
        land.heights(&grid, &mut heights);
        let spacing_m = f64::from(2u32 << level);
        let picture = RgbImage::from_fn(SIDE as u32, SIDE as u32, |column, row| {
            let at = |dx: usize, dz: usize| {
                f64::from(heights[(row as usize + dz) * (SIDE + 1) + column as usize + dx]) / 256.0
            };
            let slope = |rise: f64| rise / spacing_m;
            shade(at(0, 0), slope(at(1, 0) - at(0, 0)), slope(at(0, 1) - at(0, 0)))
        });
        let path = folder.join(format!("{stem}.png"));
        picture.save(&path).with_context(|| format!("cannot write {}", path.display()))?;
        println!(
            "{}: {:.1} km across, {spacing_m} m a pixel",
            path.display(),
            spacing_m * SIDE as f64 / 1000.0
        );
    }
    Ok(())
}

/// Colour of a point from its height in metres and its slopes east and south.
fn shade(height: f64, east: f64, south: f64) -> Rgb<u8> {
    const LIGHT: [f64; 3] = [-0.5, 0.707, -0.5];
    let length = (east * east + south * south + 1.0).sqrt();
    let lit = ((-east * LIGHT[0] + LIGHT[1] - south * LIGHT[2]) / length).max(0.0) / 0.707;
    let (tint, contrast) = match height {
        h if h < 0.0 => ([0.33 + h / 400.0, 0.50 + h / 300.0, 0.62 + h / 500.0], 0.4),
        h if h < 3.0 => ([0.80, 0.74, 0.57], 0.6),
        h => {
            let high = (h / 320.0).min(1.0);
            ([0.45 + 0.25 * high, 0.55 + 0.12 * high, 0.36 + 0.28 * high], 0.6)
        }
    };
    let light = 1.0 + (lit - 1.0) * contrast;
    Rgb(tint.map(|share| (share * light * 255.0).clamp(0.0, 255.0) as u8))
}
