//! PNG files: screenshots out, textures in.

use crate::gpu::Image;
use png::{BitDepth, ColorType, Decoder, Encoder, EncodingError, Limits, Transformations};
use std::fs::File;
use std::io::{BufReader, BufWriter, Write};
use std::path::Path;

/// Largest side of an image, pixels.
const MAX_SIDE: u32 = 8192;

/// Most memory for one image, bytes: 8192 x 8192 pixels of 8 bytes.
const MAX_BYTES: usize = 512 << 20;

/// A decoded image: 1 to 4 channels of 8 or 16 bits.
pub struct Pixels {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    channels: usize,
    /// Bytes of a channel: 1, or 2 with the high byte first.
    depth: usize,
    data: Vec<u8>,
}

impl Pixels {
    /// The colour of a pixel, each channel in [0, 1] as encoded; grey is repeated, alpha left out.
    pub fn rgb(&self, x: usize, y: usize) -> [f32; 3] {
        let pixel = self.depth * self.channels * (y * self.width + x);
        let channel = |index: usize| {
            let at = pixel + self.depth * index;
            match self.depth {
                1 => f32::from(self.data[at]) / 255.0,
                _ => f32::from(u16::from_be_bytes([self.data[at], self.data[at + 1]])) / 65_535.0,
            }
        };
        // One channel is grey, two are grey and alpha.
        if self.channels < 3 { [channel(0); 3] } else { [0, 1, 2].map(channel) }
    }
}

/// Decodes a file. Its size and the decoder's memory are limited before allocation.
///
/// # Errors
/// One line with the cause.
pub fn read(path: &Path) -> Result<Pixels, String> {
    let one_line = |error: &dyn std::fmt::Display| error.to_string().replace('\n', " ");
    // Opening a named pipe would wait for its writer.
    let is_file = std::fs::metadata(path).map_err(|error| one_line(&error))?.is_file();
    if !is_file {
        return Err("it is no regular file".to_owned());
    }
    let file = File::open(path).map_err(|error| one_line(&error))?;
    let mut decoder = Decoder::new_with_limits(BufReader::new(file), Limits { bytes: MAX_BYTES });
    // Palettes become colours, and 1 to 4 bits 8; 16 bits stay.
    decoder.set_transformations(Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(|error| one_line(&error))?;
    let (width, height) = reader.info().size();
    if width.max(height) > MAX_SIDE {
        return Err(format!("it has {width} x {height} pixels, at most {MAX_SIDE} a side are allowed"));
    }
    let size = reader.output_buffer_size().filter(|size| *size <= MAX_BYTES).ok_or("it is too large")?;
    let mut data = vec![0; size];
    let frame = reader.next_frame(&mut data).map_err(|error| one_line(&error))?;
    let channels = frame.color_type.samples();
    let depth = if frame.bit_depth == BitDepth::Sixteen { 2 } else { 1 };
    Ok(Pixels { width: width as usize, height: height as usize, channels, depth, data })
}

/// Writes an image as RGBA, 8 bits a channel; over an older file only if that succeeds.
///
/// # Errors
/// The file cannot be created, or not written to its end.
pub fn write(path: &Path, image: &Image) -> Result<(), EncodingError> {
    cli::replace_file(path, |file| write_to(file, image))
}

/// [`fn@write`] into an open file.
///
/// # Errors
/// The file cannot be written to its end.
pub fn write_to(file: File, image: &Image) -> Result<(), EncodingError> {
    let mut file = BufWriter::new(file);
    let mut encoder = Encoder::new(&mut file, image.width, image.height);
    encoder.set_color(ColorType::Rgba);
    encoder.set_depth(BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&image.rgba)?;
    writer.finish()?;
    // Dropping it would hide that the disk is full.
    Ok(file.flush()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Linux has a device that is always full.
    #[cfg(target_os = "linux")]
    #[test]
    fn an_image_that_does_not_fit_on_the_disk_is_an_error() {
        let image = Image { width: 2, height: 2, rgba: vec![7; 16] };
        assert!(write(Path::new("/dev/full"), &image).is_err());
        let path = std::env::temp_dir().join(format!("tombolo-png-{}.png", std::process::id()));
        write(&path, &image).unwrap();
        let pixels = read(&path).unwrap();
        std::fs::remove_file(path).unwrap();
        assert_eq!((pixels.width, pixels.height, pixels.rgb(1, 1)), (2, 2, [7.0 / 255.0; 3]));
    }
}
