//! The integer loops of the codec, vectorised for this machine.
//!
//! One definition in plain integers per loop. The compiler vectorises all of them except the prefix
//! sum of [`restore`], which has an implementation per instruction set. Every kernel yields the
//! same bits.
//!
//! The only unsafe code of this crate: vector instructions may only run on CPUs that have them. A
//! [`Kernel`] that needs a feature exists only where that feature was detected.
#![cfg_attr(
    target_arch = "x86_64",
    expect(unsafe_code, reason = "vector instructions; every block says what it relies on")
)]

#[cfg(target_arch = "x86_64")]
mod x86;

use std::fmt;
use terrain::constants::{VERTEX_COUNT, VERTICES};

/// The heights of a chunk, or what stands for them on the way: row by row from the low corner, x
/// fastest.
pub(super) type Heights = [i32; VERTEX_COUNT];

/// An implementation for one kind of CPU. Exists only where it can run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kernel(Set);

/// Instruction sets, from the portable one to the widest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Set {
    /// The vectors of the build target (SSE2 on x86-64, simd128 where a WebAssembly build enables
    /// it).
    Portable,
    #[cfg(target_arch = "x86_64")]
    Sse41,
    #[cfg(target_arch = "x86_64")]
    Avx2,
}

impl Kernel {
    /// Runs everywhere.
    pub const PORTABLE: Self = Self(Set::Portable);

    /// Every kernel that this machine can run, the portable one first, the fastest last.
    pub fn available() -> impl Iterator<Item = Self> {
        let sets: &[(Set, bool)] = &[
            (Set::Portable, true),
            #[cfg(target_arch = "x86_64")]
            (Set::Sse41, is_x86_feature_detected!("sse4.1")),
            #[cfg(target_arch = "x86_64")]
            (Set::Avx2, is_x86_feature_detected!("avx2")),
        ];
        sets.iter().filter(|(_, runs)| *runs).map(|(set, _)| Self(*set)).collect::<Vec<_>>().into_iter()
    }

    /// The fastest kernel that this machine can run.
    #[must_use]
    pub fn best() -> Self {
        // Feature detection is cached by the standard library: a few loads.
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx2") {
                return Self(Set::Avx2);
            }
            if is_x86_feature_detected!("sse4.1") {
                return Self(Set::Sse41);
            }
        }
        Self::PORTABLE
    }
}

impl fmt::Display for Kernel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.0 {
            Set::Portable => "portable",
            #[cfg(target_arch = "x86_64")]
            Set::Sse41 => "sse4.1",
            #[cfg(target_arch = "x86_64")]
            Set::Avx2 => "avx2",
        })
    }
}

/// Defines a function that runs a body compiled for the kernel's instruction set.
macro_rules! entry {
    (
        $(#[$doc:meta])*
        $name:ident($($argument:ident: $type:ty),*) $(-> $result:ty)?;
        $portable:path, $sse41:path, $avx2:path
    ) => {
        $(#[$doc])*
        pub(super) fn $name(kernel: Kernel, $($argument: $type),*) $(-> $result)? {
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "sse4.1")]
            fn sse41($($argument: $type),*) $(-> $result)? {
                $sse41($($argument),*)
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2")]
            fn avx2($($argument: $type),*) $(-> $result)? {
                $avx2($($argument),*)
            }
            match kernel.0 {
                Set::Portable => $portable($($argument),*),
                // SAFETY: a kernel exists only where its features were detected; so for both.
                #[cfg(target_arch = "x86_64")]
                Set::Sse41 => unsafe { sse41($($argument),*) },
                #[cfg(target_arch = "x86_64")]
                Set::Avx2 => unsafe { avx2($($argument),*) },
            }
        }
    };
}

entry! {
    /// Zigzag residuals of the plane predictor (`left + above - above left`), after a shift of the
    /// heights by `shift` bits to the right, rounded to the nearest. Returns the bits that any of
    /// them has.
    residuals(heights: &Heights, shift: u32, out: &mut [u32; VERTEX_COUNT]) -> u32;
    residuals_on, residuals_on, residuals_on
}

entry! {
    /// The lowest 8 bits of every residual above its lowest `shift` bits, as far as `mask` has
    /// them.
    split(residuals: &[u32], shift: u32, mask: u8, out: &mut [u8]) -> ();
    split_on, split_on, split_on
}

entry! {
    /// Undoes [`unpack`]: `packed` has scratch for all fields.
    pack(values: &[u8], bits: u32, packed: &mut [u8]) -> ();
    pack_on, pack_on, pack_on
}

entry! {
    /// Fields of `bits` (1, 2, 4 or 8) bits: value `i` of `out` is field `i / packed.len()` of byte
    /// `i % packed.len()`, the lowest field first.
    unpack(packed: &[u8], bits: u32, out: &mut [u8]) -> ();
    unpack_on, unpack_on, unpack_on
}

entry! {
    /// The byte plane `index` of numbers whose lowest `bits` (1, 2 or 4) come packed, as [`unpack`]
    /// takes them, and whose other bits come as byte planes, lowest first. All planes are as long
    /// as `out`.
    merge(packed: &[u8], bits: u32, planes: &[&[u8]], index: usize, out: &mut [u8]) -> ();
    merge_on, merge_on, merge_on
}

entry! {
    /// Byte planes, lowest first, to residuals with their sign.
    join(planes: &[&[u8]], out: &mut [i32]) -> ();
    join_on, join_on, join_on
}

entry! {
    /// Byte planes, lowest first, of the plane predictor's residuals to heights, from the height of
    /// the first vertex. Returns the lowest and the highest.
    restore(planes: &[&[u8]], first: i32, heights: &mut Heights) -> (i32, i32);
    restore_on, x86::restore_sse41, x86::restore_avx2
}

#[inline(always)]
fn residuals_on(heights: &Heights, shift: u32, out: &mut [u32; VERTEX_COUNT]) -> u32 {
    let half = (1 << shift) >> 1;
    let mut above = [heights[0].wrapping_add(half) >> shift; VERTICES];
    let mut any = 0;
    for (row, out) in heights.as_chunks::<VERTICES>().0.iter().zip(out.as_chunks_mut::<VERTICES>().0) {
        // The height of each vertex above the one a row earlier; the residual is its change along
        // the row.
        let mut rise = [0; VERTICES];
        for ((rise, above), height) in rise.iter_mut().zip(&mut above).zip(row) {
            let height = height.wrapping_add(half) >> shift;
            *rise = height.wrapping_sub(*above);
            *above = height;
        }
        out[0] = zigzag(rise[0]);
        for (out, pair) in out[1..].iter_mut().zip(rise.windows(2)) {
            *out = zigzag(pair[1].wrapping_sub(pair[0]));
        }
        any |= out.iter().fold(0, |all, residual| all | residual);
    }
    any
}

#[inline(always)]
fn split_on(residuals: &[u32], shift: u32, mask: u8, out: &mut [u8]) {
    for (byte, residual) in out.iter_mut().zip(residuals) {
        *byte = (residual >> shift) as u8 & mask;
    }
}

#[inline(always)]
fn pack_on(values: &[u8], bits: u32, packed: &mut [u8]) {
    packed.fill(0);
    for (field, values) in values.chunks(packed.len().max(1)).enumerate() {
        let shift = field as u32 * bits;
        for (byte, value) in packed.iter_mut().zip(values) {
            *byte |= value << shift;
        }
    }
}

#[inline(always)]
fn unpack_on(packed: &[u8], bits: u32, out: &mut [u8]) {
    let mask = (0xff_u16 >> (8 - bits)) as u8;
    for (field, out) in out.chunks_mut(packed.len().max(1)).enumerate() {
        let shift = field as u32 * bits;
        for (value, byte) in out.iter_mut().zip(packed) {
            *value = (byte >> shift) & mask;
        }
    }
}

#[inline(always)]
fn merge_on(packed: &[u8], bits: u32, planes: &[&[u8]], index: usize, out: &mut [u8]) {
    match (index, planes.get(index)) {
        (0, Some(plane)) => {
            let mask = (0xff_u16 >> (8 - bits)) as u8;
            let chunks = out.chunks_mut(packed.len().max(1)).zip(plane.chunks(packed.len().max(1)));
            for (field, (out, plane)) in chunks.enumerate() {
                let shift = field as u32 * bits;
                for ((out, byte), low) in out.iter_mut().zip(plane).zip(packed) {
                    *out = byte << bits | (low >> shift & mask);
                }
            }
        }
        (0, None) => unpack_on(packed, bits, out),
        (_, Some(plane)) => {
            for ((out, byte), below) in out.iter_mut().zip(*plane).zip(planes[index - 1]) {
                *out = byte << bits | below >> (8 - bits);
            }
        }
        (_, None) => {
            let below = planes.get(index - 1).copied().unwrap_or_default();
            for (out, below) in out.iter_mut().zip(below) {
                *out = below >> (8 - bits);
            }
        }
    }
}

#[inline(always)]
fn join_on(planes: &[&[u8]], out: &mut [i32]) {
    match *planes {
        [] => out.fill(0),
        [low] => {
            for (out, low) in out.iter_mut().zip(low) {
                *out = unzigzag(u32::from(*low));
            }
        }
        [low, high] => {
            for ((out, low), high) in out.iter_mut().zip(low).zip(high) {
                *out = unzigzag(u32::from(*low) | u32::from(*high) << 8);
            }
        }
        _ => {
            for (index, out) in out.iter_mut().enumerate() {
                let byte = |plane: &[u8]| plane.get(index).copied().map_or(0, u32::from);
                *out = unzigzag(planes.iter().rev().fold(0, |word, plane| word << 8 | byte(plane)));
            }
        }
    }
}

#[inline(always)]
fn restore_on(planes: &[&[u8]], first: i32, heights: &mut Heights) -> (i32, i32) {
    join_on(planes, heights);
    let mut above = [first; VERTICES];
    let (mut low, mut high) = (i32::MAX, i32::MIN);
    for row in heights.as_chunks_mut::<VERTICES>().0 {
        let mut rise = 0i32;
        for (height, above) in row.iter_mut().zip(&mut above) {
            rise = rise.wrapping_add(*height);
            *above = above.wrapping_add(rise);
            *height = *above;
            (low, high) = (low.min(*above), high.max(*above));
        }
    }
    (low, high)
}

/// Small magnitudes of both signs as small numbers.
pub(super) const fn zigzag(value: i32) -> u32 {
    ((value << 1) ^ (value >> 31)) as u32
}

/// Undoes [`zigzag`].
pub(super) const fn unzigzag(value: u32) -> i32 {
    (value >> 1) as i32 ^ -((value & 1) as i32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;
    use terrain::hash::mix;

    fn noise(seed: u32, keep: u32) -> Box<Heights> {
        let mut heights = Box::new([0; VERTEX_COUNT]);
        for (index, height) in heights.iter_mut().enumerate() {
            *height = (mix(seed ^ index as u32) as i32).checked_shr(keep).unwrap_or(0);
        }
        heights
    }

    /// The predictor as docs/protocol.md states it.
    fn stated(heights: &Heights, index: usize) -> i32 {
        match (index % VERTICES, index / VERTICES) {
            (0, 0) => heights[0],
            (_, 0) => heights[index - 1],
            (0, _) => heights[index - VERTICES],
            _ => heights[index - 1] + heights[index - VERTICES] - heights[index - VERTICES - 1],
        }
    }

    #[test]
    fn this_machine_has_the_portable_kernel_and_the_best_is_available() {
        assert_eq!(Kernel::available().next(), Some(Kernel::PORTABLE));
        assert!(Kernel::available().any(|kernel| kernel == Kernel::best()));
    }

    #[test]
    fn every_kernel_has_a_name_of_its_own() {
        let names: BTreeSet<_> = Kernel::available().map(|kernel| kernel.to_string()).collect();
        assert!(names.len() == Kernel::available().count() && names.contains("portable"), "{names:?}");
    }

    #[test]
    fn residuals_are_those_of_the_stated_predictor_on_every_kernel() {
        let heights = noise(3, 8);
        for kernel in Kernel::available() {
            let mut got = Box::new([0; VERTEX_COUNT]);
            let any = residuals(kernel, &heights, 0, &mut got);
            for index in 0..VERTEX_COUNT {
                assert_eq!(
                    unzigzag(got[index]),
                    heights[index] - stated(&heights, index),
                    "{kernel} {index}"
                );
            }
            assert_eq!(any, got.iter().fold(0, |all, word| all | word), "{kernel}");
        }
    }

    /// Rows whose sums come close to 16 bits and leave them, in both directions: kernels may hold
    /// the sums of a row in 16 bits where they fit.
    #[test]
    fn rows_at_the_limit_of_16_bits_are_restored_on_every_kernel() {
        // The rise of the first vertex, and the sum of the upper bytes of the others.
        let cases =
            [(8_192, 127), (8_193, 127), (8_192, 128), (8_192, 200), (20_000, 127), (32_767, 64 * 255)];
        for (rise, upper) in cases.into_iter().flat_map(|(rise, upper)| [(rise, upper), (-rise, upper)]) {
            let mut words = Box::new([0; VERTEX_COUNT]);
            for (index, row) in words.as_chunks_mut::<VERTICES>().0.iter_mut().enumerate() {
                // The largest residuals of their upper bytes, with the sign of the rise; every
                // other row goes back.
                let rise = if index % 2 == 0 { rise } else { -rise };
                for (x, word) in row.iter_mut().enumerate() {
                    let upper = upper / 64 + u32::from((x as u32) < upper % 64);
                    *word = (256 * upper + 254) | u32::from(rise < 0);
                }
                row[0] = zigzag(rise);
            }
            let mut planes = [(); 2].map(|()| vec![0; VERTEX_COUNT]);
            for (out, shift) in planes.iter_mut().zip([0, 8]) {
                split(Kernel::PORTABLE, &words[..], shift, 0xff, out);
            }
            let planes: Vec<_> = planes.iter().map(|plane| &plane[..]).collect();
            let mut stated = Box::new([1; VERTEX_COUNT]);
            let range = restore(Kernel::PORTABLE, &planes, 5, &mut stated);
            assert!(upper < 200 || range.1 - range.0 >= 1 << 15, "{rise} {upper}: no row leaves 16 bits");
            for kernel in Kernel::available() {
                let mut got = Box::new([2; VERTEX_COUNT]);
                assert_eq!(restore(kernel, &planes, 5, &mut got), range, "{kernel} {rise} {upper}");
                assert_eq!(got, stated, "{kernel} {rise} {upper}");
            }
        }
    }

    #[test]
    fn no_planes_are_a_flat_chunk_on_every_kernel() {
        for kernel in Kernel::available() {
            let mut heights = Box::new([1; VERTEX_COUNT]);
            assert_eq!(restore(kernel, &[], -64, &mut heights), (-64, -64), "{kernel}");
            assert!(heights.iter().all(|height| *height == -64), "{kernel}");
        }
    }

    proptest! {
        #[test]
        fn every_kernel_equals_the_portable_one_and_round_trips(
            seed: u32, keep in 8u32..32, shift in 0u32..9, count in 1usize..600,
        ) {
            let heights = noise(seed, keep);
            let mut expected = Box::new([0; VERTEX_COUNT]);
            let any = residuals(Kernel::PORTABLE, &heights, shift, &mut expected);
            let half = (1 << shift) >> 1;
            for kernel in Kernel::available() {
                let mut got = Box::new([0; VERTEX_COUNT]);
                prop_assert_eq!(residuals(kernel, &heights, shift, &mut got), any);
                prop_assert_eq!(&got, &expected);

                let mut planes = [(); 4].map(|()| vec![0; VERTEX_COUNT]);
                for (out, shift) in planes.iter_mut().zip([0, 8, 16, 24]) {
                    split(kernel, &got[..], shift, 0xff, out);
                }
                let planes: Vec<_> = planes.iter().map(|plane| &plane[..]).collect();
                for used in 1..=4 {
                    let mut signed = Box::new([0; VERTEX_COUNT]);
                    join(kernel, &planes[..used], &mut signed[..]);
                    let kept = u32::MAX >> (32 - 8 * used as u32);
                    for (signed, word) in signed.iter().zip(&got[..]) {
                        prop_assert_eq!(zigzag(*signed), word & kept);
                    }
                    let first = (heights[0] + half) >> shift;
                    let mut restored = Box::new([1; VERTEX_COUNT]);
                    let mut stated = Box::new([2; VERTEX_COUNT]);
                    let range = restore(kernel, &planes[..used], first, &mut restored);
                    prop_assert_eq!(range, restore(Kernel::PORTABLE, &planes[..used], first, &mut stated));
                    prop_assert_eq!(&restored, &stated);
                    if used == 4 {
                        for (restored, height) in restored.iter().zip(&heights[..]) {
                            prop_assert_eq!(*restored, (height + half) >> shift);
                        }
                        let lowest = restored.iter().min().copied().unwrap();
                        prop_assert_eq!(range, (lowest, restored.iter().max().copied().unwrap()));
                    }
                }

                let packed: Vec<_> = (0..count as u32).map(|index| mix(index) as u8).collect();
                for bits in [1, 2, 4, 8] {
                    let values = count * (8 / bits) - usize::from(count > 1);
                    let mut out = vec![0; values];
                    unpack(kernel, &packed, bits as u32, &mut out);
                    for (index, value) in out.iter().enumerate() {
                        let field = packed[index % count] >> (index / count * bits);
                        prop_assert_eq!(*value, field & (0xff_u16 >> (8 - bits)) as u8);
                    }
                    let (mut again, mut portable) = (vec![1; count], vec![2; count]);
                    pack(kernel, &out, bits as u32, &mut again);
                    pack(Kernel::PORTABLE, &out, bits as u32, &mut portable);
                    prop_assert_eq!(&again, &portable);
                    let mut back = vec![0; values];
                    unpack(kernel, &again, bits as u32, &mut back);
                    prop_assert_eq!(back, out);
                }

                let words: Vec<_> = got[..count].iter().map(|word| word >> 4).collect();
                for bits in [1, 2, 4] {
                    let mut low = vec![0; (count * bits).div_ceil(8)];
                    let fields = low.len();
                    for (index, word) in words.iter().enumerate() {
                        low[index % fields] |= ((word & ((1 << bits) - 1)) << (index / fields * bits)) as u8;
                    }
                    let above: Vec<_> = words.iter().map(|word| word >> bits).collect();
                    let mut planes = [(); 4].map(|()| vec![0; count]);
                    for (out, shift) in planes.iter_mut().zip([0, 8, 16, 24]) {
                        split(kernel, &above, shift, 0xff, out);
                    }
                    let planes: Vec<_> = planes.iter().map(|plane| &plane[..]).collect();
                    for (used, index) in (0..=4).flat_map(|used| (0..4).map(move |index| (used, index))) {
                        let mut out = vec![0xaa; count];
                        if index > used {
                            continue;
                        }
                        merge(kernel, &low, bits as u32, &planes[..used], index, &mut out);
                        let kept = ((1u64 << (8 * used + bits)) - 1) as u32;
                        for (out, word) in out.iter().zip(&words) {
                            let expected = ((word & kept) >> (8 * index)) as u8;
                            prop_assert_eq!(*out, expected, "{} {} {}", bits, used, index);
                        }
                    }
                }
            }
        }
    }
}
