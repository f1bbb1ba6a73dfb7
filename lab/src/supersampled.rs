//! Pictures that are drawn finer than they are compared.

use client::gpu::Image;

/// The drawn size of a picture that is `times` as wide and high.
pub fn size((width, height): (u32, u32), times: u32) -> (u32, u32) {
    (width * times, height * times)
}

/// Downsampled by a box filter of `times` x `times` pixels in linear light.
pub fn averaged(fine: &Image, times: u32) -> Image {
    let (width, height) = (fine.width / times, fine.height / times);
    let linear = |byte: u8| (f64::from(byte) / 255.0).powf(2.2);
    let mut rgba = Vec::with_capacity((4 * width * height) as usize);
    for row in 0..height {
        for column in 0..width {
            for channel in 0..3 {
                let of = |x: u32, y: u32| {
                    let pixel = (row * times + y) * fine.width + column * times + x;
                    linear(fine.rgba[(4 * pixel + channel) as usize])
                };
                let sum: f64 =
                    (0..times).flat_map(|y| (0..times).map(move |x| (x, y))).map(|(x, y)| of(x, y)).sum();
                let mean = sum / f64::from(times * times);
                rgba.push((255.0 * mean.powf(1.0 / 2.2)).round() as u8);
            }
            rgba.push(255);
        }
    }
    Image { width, height, rgba }
}
