//! Comparing pictures with golden ones.
//!
//! Golden pictures are in `tests/golden/`; `driver.txt` there names the driver that drew them. That
//! driver must draw them again byte for byte. Every other driver must draw them within a tolerance.
//! `TOMBOLO_BLESS=1` writes the pictures and the name of the driver; a failure writes the rendered
//! picture and names its path.

use crate::rendering::open_gpu_or_skip;
use client::gpu::Image;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

/// Side of the blocks of [`Difference::block`], pixels.
const BLOCK: usize = 16;

/// A difference of a colour channel that makes a pixel an outlier.
const OUTLIER: u8 = 32;

/// The difference of two pictures. All differences are absolute, 0 to 255.
#[must_use]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// Mean over pixels and colour channels.
    pub mean: f64,
    /// Share of pixels with a channel that differs by more than 32.
    pub outliers: f64,
    /// The same mean over the worst block of 16 x 16 pixels: one missing object is in few blocks.
    pub block: f64,
}

/// The tolerated difference between two drivers, about one and a half times what llvmpipe and
/// SwiftShader differ by (at most 0.28, 0.13 % and 2.6). Drivers round, fuse and reorder float
/// arithmetic, and triangle edges move by a fraction of a pixel.
pub const TOLERANCE: Difference = Difference { mean: 0.5, outliers: 0.003, block: 4.0 };

/// The tolerance of pictures with triangles smaller than pixels, of which drivers hit others: about
/// one and a half times the difference of the same drivers (1.9, 2.3 % and 6.6).
pub const FINE_TOLERANCE: Difference = Difference { mean: 3.0, outliers: 0.04, block: 10.0 };

impl Difference {
    /// Measures two pictures. Pictures of different size are entirely different.
    pub fn between(one: &Image, two: &Image) -> Self {
        if (one.width, one.height) != (two.width, two.height) {
            return Self { mean: 255.0, outliers: 1.0, block: 255.0 };
        }
        let (width, height) = (one.width as usize, one.height as usize);
        let blocks_wide = width.div_ceil(BLOCK);
        // Sum of differences and number of channels.
        let mut blocks = vec![(0u64, 0u64); blocks_wide * height.div_ceil(BLOCK)];
        let mut outliers = 0u64;
        let pixels = one.rgba.as_chunks::<4>().0.iter().zip(two.rgba.as_chunks::<4>().0);
        for (at, (a, b)) in pixels.enumerate() {
            let differences = [0, 1, 2].map(|channel| a[channel].abs_diff(b[channel]));
            let block = &mut blocks[at / width / BLOCK * blocks_wide + at % width / BLOCK];
            block.0 += differences.iter().map(|difference| u64::from(*difference)).sum::<u64>();
            block.1 += 3;
            outliers += u64::from(differences.iter().any(|difference| *difference > OUTLIER));
        }
        let mean = |(sum, channels): (u64, u64)| sum as f64 / channels as f64;
        let total = blocks.iter().fold((0, 0), |all, block| (all.0 + block.0, all.1 + block.1));
        Self {
            mean: mean(total),
            outliers: outliers as f64 / (width * height) as f64,
            block: blocks.into_iter().map(mean).fold(0.0, f64::max),
        }
    }

    /// Whether the difference is within [`TOLERANCE`].
    #[must_use]
    pub fn is_tolerable(&self) -> bool {
        self.is_within(TOLERANCE)
    }

    /// Whether no figure exceeds that of a tolerance.
    #[must_use]
    pub fn is_within(&self, tolerance: Self) -> bool {
        self.mean <= tolerance.mean && self.outliers <= tolerance.outliers && self.block <= tolerance.block
    }

    /// The figure that exceeds that of a tolerance by most, in times of it.
    #[must_use]
    pub fn over(&self, tolerance: Self) -> f64 {
        let mean = self.mean / tolerance.mean;
        mean.max(self.outliers / tolerance.outliers).max(self.block / tolerance.block)
    }
}

/// Name and version of the driver that draws here; none without a GPU.
static DRIVER: LazyLock<Option<String>> = LazyLock::new(|| {
    let info = open_gpu_or_skip()?.adapter.get_info();
    Some(format!("{}, {} {}, {}", info.name, info.driver, info.driver_info, info.backend))
});

/// Whether golden pictures are being written, so that nothing can be compared with them yet.
#[must_use]
pub fn is_blessing() -> bool {
    std::env::var_os("TOMBOLO_BLESS").is_some()
}

/// Compares a picture with the golden one of a name within [`TOLERANCE`], or writes that one when
/// blessing.
///
/// # Errors
/// One line with the difference and the path of the rendered picture.
pub fn check(name: &str, picture: &Image) -> Result<(), String> {
    check_within(name, picture, TOLERANCE)
}

/// As [`check`], within another tolerance.
///
/// # Errors
/// As [`check`].
pub fn check_within(name: &str, picture: &Image, tolerance: Difference) -> Result<(), String> {
    let driver = DRIVER.as_deref().unwrap_or("none");
    if is_blessing() {
        let path = folder().join("driver.txt");
        std::fs::write(&path, driver).map_err(|error| format!("cannot write {}: {error}", path.display()))?;
        return write(&folder().join(format!("{name}.png")), picture);
    }
    let golden = golden(name)?;
    let difference = Difference::between(&golden, picture);
    let is_same_driver = std::fs::read_to_string(folder().join("driver.txt")).is_ok_and(|own| own == driver);
    let (is_good, expected) = if is_same_driver {
        (golden.rgba == picture.rgba, "equal bytes, as the same driver drew it".to_owned())
    } else {
        (difference.is_within(tolerance), format!("{tolerance:?}"))
    };
    if is_good {
        return Ok(());
    }
    let rendered = std::env::temp_dir().join(format!("tombolo-{name}-rendered.png"));
    write(&rendered, picture)?;
    Err(format!(
        "{name} differs from its golden picture: {difference:?} against {expected} ({driver}); see {}; if it \
        should differ, run `cargo xtask bless pictures --write`",
        rendered.display()
    ))
}

/// Requires a near miss to differ by more than a tolerance. `TOMBOLO_NEAR_MISSES` names a file to
/// which the outcome is appended as a line: `rejected` or `passed`, the near miss and its distance.
///
/// # Panics
/// The difference is tolerated, or the file cannot be written.
pub fn require_rejected(near_miss: &str, difference: Difference, tolerance: Difference) {
    let is_rejected = !difference.is_within(tolerance);
    eprintln!("{near_miss}: {difference:?}");
    if let Some(path) = std::env::var_os("TOMBOLO_NEAR_MISSES") {
        let outcome = if is_rejected { "rejected" } else { "passed" };
        let file = std::fs::File::options().append(true).create(true).open(path);
        // One write, as other tests append at the same time.
        let distance = format!("{:.2} times the tolerance", difference.over(tolerance));
        let line = format!("{outcome} {near_miss} ({distance})\n");
        let written = file.and_then(|mut file| file.write_all(line.as_bytes()));
        written.expect("the file of TOMBOLO_NEAR_MISSES can be written");
    }
    assert!(is_rejected, "{near_miss} passed: {difference:?}");
}

/// A golden picture.
///
/// # Errors
/// One line with the path.
pub fn golden(name: &str) -> Result<Image, String> {
    let path = folder().join(format!("{name}.png"));
    let golden =
        image::open(&path).map_err(|error| format!("cannot read {}: {error}", path.display()))?.to_rgba8();
    Ok(Image { width: golden.width(), height: golden.height(), rgba: golden.into_raw() })
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("golden")
}

fn write(path: &Path, picture: &Image) -> Result<(), String> {
    image::save_buffer(path, &picture.rgba, picture.width, picture.height, image::ColorType::Rgba8)
        .map_err(|error| format!("cannot write {}: {error}", path.display()))
}
