//! Comparing pictures with golden ones.
//!
//! Golden pictures are in `tests/golden/`. `TOMBOLO_BLESS=1` writes them; a failure writes the
//! rendered picture and names its path.

use client::gpu::Image;
use std::path::{Path, PathBuf};

/// The difference of two pictures.
#[must_use]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// Mean over pixels and colour channels of the absolute difference, 0 to 255.
    pub mean: f64,
    /// Share of pixels with a channel that differs by more than 32.
    pub outliers: f64,
}

/// The tolerated difference. Drivers may round, fuse and reorder float arithmetic, and triangle
/// edges may move by a fraction of a pixel: single pixels at silhouettes change a lot, all others
/// hardly. A wrong shade, position or shape changes many pixels.
pub const TOLERANCE: Difference = Difference { mean: 1.5, outliers: 0.01 };

impl Difference {
    /// Measures two pictures. Pictures of different size are entirely different.
    pub fn between(one: &Image, two: &Image) -> Self {
        if (one.width, one.height) != (two.width, two.height) {
            return Self { mean: 255.0, outliers: 1.0 };
        }
        let (mut sum, mut outliers) = (0u64, 0u64);
        for (a, b) in one.rgba.chunks_exact(4).zip(two.rgba.chunks_exact(4)) {
            let differences = [0, 1, 2].map(|channel| a[channel].abs_diff(b[channel]));
            sum += differences.iter().map(|difference| u64::from(*difference)).sum::<u64>();
            outliers += u64::from(differences.iter().any(|difference| *difference > 32));
        }
        let pixels = f64::from(one.width) * f64::from(one.height);
        Self { mean: sum as f64 / (3.0 * pixels), outliers: outliers as f64 / pixels }
    }

    /// Whether the difference is within [`TOLERANCE`].
    #[must_use]
    pub fn is_tolerable(&self) -> bool {
        self.mean <= TOLERANCE.mean && self.outliers <= TOLERANCE.outliers
    }
}

/// Compares a picture with the golden one of a name, or writes that one when blessing.
///
/// # Errors
/// One line with the difference and the path of the rendered picture.
pub fn check(name: &str, picture: &Image) -> Result<(), String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("golden").join(format!("{name}.png"));
    if std::env::var_os("TOMBOLO_BLESS").is_some() {
        return write(&path, picture);
    }
    let golden =
        image::open(&path).map_err(|error| format!("cannot read {}: {error}", path.display()))?.to_rgba8();
    let golden = Image { width: golden.width(), height: golden.height(), rgba: golden.into_raw() };
    let difference = Difference::between(&golden, picture);
    if difference.is_tolerable() {
        return Ok(());
    }
    let rendered = rendered_path(name);
    write(&rendered, picture)?;
    Err(format!(
        "{name} differs from its golden picture: {difference:?} against {TOLERANCE:?}; see {}",
        rendered.display()
    ))
}

fn rendered_path(name: &str) -> PathBuf {
    std::env::temp_dir().join(format!("tombolo-{name}-rendered.png"))
}

fn write(path: &Path, picture: &Image) -> Result<(), String> {
    image::save_buffer(path, &picture.rgba, picture.width, picture.height, image::ColorType::Rgba8)
        .map_err(|error| format!("cannot write {}: {error}", path.display()))
}
