//! `--textures`: a folder of images becomes material sets.
//!
//! Every file that is bad or missing is named in one line with what is used instead; none of them is a reason to stop. An image is never trusted:
//! its size and the memory of its decoder are limited before anything is allocated.

use crate::native::args::Args;
use crate::render::materials::{MATERIAL_SIZE, MATERIAL_TEXELS, OwnMaterial, OwnMaterials};
use anyhow::Context as _;
use image::{DynamicImage, ImageReader, Limits};
use shaders::layout::{BakeTexel, MATERIALS};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Largest side of an image, pixels.
const MAX_SIDE: u32 = 8192;

/// Most memory for one image, bytes: 8192 x 8192 pixels of 8 bytes.
const MAX_BYTES: u64 = 512 << 20;

/// Squares of the checker along a side.
const CHECKS: usize = 16;

/// What an image of a set says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Map {
    Albedo,
    Normal,
    Height,
    Roughness,
    Occlusion,
}

impl Map {
    const ALL: [Self; 5] = [Self::Albedo, Self::Normal, Self::Height, Self::Roughness, Self::Occlusion];

    /// What its files are called after the name of the set and an underscore; the first name is the usual one.
    const fn names(self) -> &'static [&'static str] {
        match self {
            Self::Albedo => &["albedo", "basecolor", "base_color", "diffuse", "diff", "color", "col"],
            Self::Normal => &["normal", "normalgl", "normal_gl", "nor_gl", "nrm"],
            Self::Height => &["height", "displacement", "disp"],
            Self::Roughness => &["roughness", "rough"],
            Self::Occlusion => &["ao", "ambientocclusion", "ambient_occlusion", "occlusion"],
        }
    }

    /// What stands in for it.
    const fn substitute(self) -> &'static str {
        match self {
            Self::Albedo => "a checker",
            Self::Normal => "normals from the height",
            Self::Height => "a flat height",
            Self::Roughness => "roughness 0.9",
            Self::Occlusion => "occlusion from the height",
        }
    }
}

/// The sets that the options name; complaints go to standard error.
///
/// # Errors
/// The folder itself cannot be read.
pub fn own(args: &Args) -> anyhow::Result<OwnMaterials> {
    let Some(folder) = &args.textures else { return Ok(OwnMaterials::default()) };
    let (materials, complaints) = load(folder)?;
    for complaint in complaints {
        eprintln!("{complaint}");
    }
    Ok(materials)
}

/// Reads a folder: the sets with at least one file, and a line for each file that is bad or missing.
///
/// # Errors
/// The folder itself cannot be read.
pub fn load(folder: &Path) -> anyhow::Result<(OwnMaterials, Vec<String>)> {
    let unreadable = || {
        format!("cannot read --textures {}: name a folder of files such as sand_albedo.png", folder.display())
    };
    let mut files: [BTreeMap<Map, PathBuf>; MATERIALS.len()] = Default::default();
    let mut complaints = Vec::new();
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(unreadable)? {
        paths.push(entry.with_context(unreadable)?.path());
    }
    // Folders list in any order; which of two files for one map is taken must not depend on it.
    paths.sort();
    for path in paths {
        let Some((material, map)) = meaning(&path) else { continue };
        if let Some(taken) = files[material].get(&map) {
            complaints.push(format!(
                "{}: {} says the same, which is used",
                path.display(),
                taken.file_name().unwrap_or_default().display()
            ));
        } else {
            files[material].insert(map, path);
        }
    }
    let mut index = 0;
    let materials = files.map(|files| {
        let name = MATERIALS[index];
        index += 1;
        (!files.is_empty()).then(|| assemble(folder, name, &files, &mut complaints))
    });
    Ok((OwnMaterials::new(materials), complaints))
}

/// Which map of which set a file is, by its name; case does not matter.
fn meaning(path: &Path) -> Option<(usize, Map)> {
    let stem = path.file_stem()?.to_str()?.to_ascii_lowercase().replace('-', "_");
    let extension = path.extension()?.to_str()?.to_ascii_lowercase();
    if extension != "png" {
        return None;
    }
    MATERIALS.iter().enumerate().find_map(|(index, material)| {
        let rest = stem.strip_prefix(material)?.strip_prefix('_')?;
        let map = Map::ALL.into_iter().find(|map| map.names().contains(&rest))?;
        Some((index, map))
    })
}

/// One set from its files. What is missing or bad is replaced and said.
fn assemble(
    folder: &Path,
    material: &str,
    files: &BTreeMap<Map, PathBuf>,
    complaints: &mut Vec<String>,
) -> OwnMaterial {
    let mut read = |map: Map| {
        let Some(path) = files.get(&map) else {
            let path = folder.join(format!("{material}_{}.png", map.names()[0]));
            complaints.push(format!("{}: there is no such file, using {}", path.display(), map.substitute()));
            return None;
        };
        match decode(path) {
            Ok(image) => Some(resampled(&image, map == Map::Albedo)),
            Err(cause) => {
                complaints.push(format!("{}: {cause}, using {}", path.display(), map.substitute()));
                None
            }
        }
    };
    let [albedo, normal, height, roughness, occlusion] = Map::ALL.map(&mut read);
    let texels = (0..MATERIAL_TEXELS).map(|at| {
        let grey = |image: &Option<Vec<[f32; 3]>>, missing: f32| image.as_ref().map_or(missing, |image| image[at][0]);
        BakeTexel {
            albedo: albedo.as_ref().map_or_else(|| checker(at), |albedo| albedo[at]),
            height: grey(&height, 0.5),
            // Green points up in images and v points down in textures.
            normal: normal.as_ref().map_or([0.0; 2], |normal| unit_part(normal[at])),
            roughness: grey(&roughness, 0.9),
            occlusion: grey(&occlusion, 1.0),
        }
    });
    OwnMaterial {
        texels: texels.collect(),
        normals_given: normal.is_some(),
        occlusion_given: occlusion.is_some(),
    }
}

/// Magenta and black squares: nobody overlooks them.
fn checker(at: usize) -> [f32; 3] {
    let side = MATERIAL_SIZE as usize;
    let square = |place: usize| place * CHECKS / side;
    if (square(at % side) + square(at / side)).is_multiple_of(2) { [0.8, 0.0, 0.8] } else { [0.02; 3] }
}

/// The horizontal part of an encoded normal, made unit where filtering or the file has shortened it.
fn unit_part(encoded: [f32; 3]) -> [f32; 2] {
    let [x, y, z] = encoded.map(|channel| channel.mul_add(2.0, -1.0));
    let z = z.max(0.05);
    let length = (x * x + y * y + z * z).sqrt();
    [x / length, -y / length]
}

/// Decodes within limits. The cause of a failure is one line.
fn decode(path: &Path) -> Result<DynamicImage, String> {
    let one_line = |error: &dyn std::fmt::Display| error.to_string().replace('\n', " ");
    let mut reader = ImageReader::open(path).map_err(|error| one_line(&error))?;
    reader.set_format(image::ImageFormat::Png);
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_BYTES);
    reader.limits(limits);
    let image = reader.decode().map_err(|error| one_line(&error))?;
    if image.width() == 0 || image.height() == 0 {
        return Err("it has no pixels".to_owned());
    }
    Ok(image)
}

/// Pixels in [0, 1] at the size of the textures; `colour` ones are decoded from sRGB first. Averages where the image is larger, interpolates where it is
/// smaller; opposite edges meet, because a texture repeats.
fn resampled(image: &DynamicImage, colour: bool) -> Vec<[f32; 3]> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let side = MATERIAL_SIZE as usize;
    // Row by row, so that no second copy of a large image is made as floats.
    let pixel = |x: usize, y: usize| -> [f32; 3] {
        let (x, y) = ((x % width) as u32, (y % height) as u32);
        let channels = match image {
            DynamicImage::ImageLuma8(image) => [f32::from(image.get_pixel(x, y).0[0]) / 255.0; 3],
            DynamicImage::ImageLumaA8(image) => [f32::from(image.get_pixel(x, y).0[0]) / 255.0; 3],
            DynamicImage::ImageLuma16(image) => [f32::from(image.get_pixel(x, y).0[0]) / 65_535.0; 3],
            DynamicImage::ImageLumaA16(image) => [f32::from(image.get_pixel(x, y).0[0]) / 65_535.0; 3],
            DynamicImage::ImageRgb8(image) => image.get_pixel(x, y).0.map(|c| f32::from(c) / 255.0),
            DynamicImage::ImageRgba8(image) => three(image.get_pixel(x, y).0).map(|c| f32::from(c) / 255.0),
            DynamicImage::ImageRgb16(image) => image.get_pixel(x, y).0.map(|c| f32::from(c) / 65_535.0),
            DynamicImage::ImageRgba16(image) => {
                three(image.get_pixel(x, y).0).map(|c| f32::from(c) / 65_535.0)
            }
            // PNG has no other kinds.
            _ => [0.0; 3],
        };
        if colour { channels.map(linear) } else { channels }
    };
    let across = taps(width, side);
    let down = taps(height, side);
    let mut out = Vec::with_capacity(MATERIAL_TEXELS);
    for rows in &down {
        for columns in &across {
            let mut sum = [0.0; 3];
            for &(y, down_share) in rows {
                for &(x, share) in columns {
                    let channels = pixel(x, y);
                    for (sum, channel) in sum.iter_mut().zip(channels) {
                        *sum += channel * share * down_share;
                    }
                }
            }
            out.push(sum);
        }
    }
    out
}

fn three<T: Copy>([a, b, c, _]: [T; 4]) -> [T; 3] {
    [a, b, c]
}

/// For each of `to` places: which of `from` samples count there, and how much; shares sum to 1.
fn taps(from: usize, to: usize) -> Vec<Vec<(usize, f32)>> {
    let scale = from as f64 / to as f64;
    let place = |index: usize| {
        let centre = (index as f64 + 0.5) * scale - 0.5;
        // A tent as wide as the coarser of both grids: interpolation upward, an average downward.
        let radius = scale.max(1.0);
        let low = (centre - radius).ceil() as i64;
        let high = (centre + radius).floor() as i64;
        let shares: Vec<(usize, f64)> = (low..=high)
            .map(|at| (at.rem_euclid(from as i64) as usize, 1.0 - (at as f64 - centre).abs() / radius))
            .collect();
        let total: f64 = shares.iter().map(|(_, share)| share).sum();
        shares.into_iter().map(|(at, share)| (at, (share / total) as f32)).collect()
    };
    (0..to).map(place).collect()
}

/// The sRGB transfer function (IEC 61966-2-1), undone.
fn linear(encoded: f32) -> f32 {
    if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}
