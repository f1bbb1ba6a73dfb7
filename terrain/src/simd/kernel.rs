//! The kernels of this machine: which instruction sets exist and which of them can run.

use std::fmt;

/// An implementation for one kind of CPU. Exists only where it can run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kernel(pub(super) Set);

/// Instruction sets, from the portable one to the widest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Set {
    Scalar,
    #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
    Simd128,
    #[cfg(target_arch = "x86_64")]
    Sse41,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Kernel {
    /// Plain integers, one vertex at a time: runs everywhere.
    pub const SCALAR: Self = Self(Set::Scalar);

    /// Every kernel that this machine can run, the portable one first, the fastest last.
    pub fn available() -> impl Iterator<Item = Self> {
        let sets: &[(Set, bool)] = &[
            (Set::Scalar, true),
            #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
            (Set::Simd128, true),
            #[cfg(target_arch = "x86_64")]
            (Set::Sse41, is_x86_feature_detected!("sse4.1") && is_x86_feature_detected!("ssse3")),
            #[cfg(target_arch = "x86_64")]
            (Set::Avx2, is_x86_feature_detected!("avx2")),
            #[cfg(target_arch = "x86_64")]
            (Set::Avx512, has_avx512()),
        ];
        sets.iter().filter(|(_, runs)| *runs).map(|(set, _)| Self(*set)).collect::<Vec<_>>().into_iter()
    }

    /// The fastest kernel that this machine can run.
    #[must_use]
    pub fn best() -> Self {
        // Feature detection is cached by the standard library: a few loads.
        #[cfg(target_arch = "x86_64")]
        {
            if has_avx512() {
                return Self(Set::Avx512);
            }
            if is_x86_feature_detected!("avx2") {
                return Self(Set::Avx2);
            }
            if is_x86_feature_detected!("sse4.1") && is_x86_feature_detected!("ssse3") {
                return Self(Set::Sse41);
            }
        }
        #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
        return Self(Set::Simd128);
        #[cfg(not(all(target_arch = "wasm32", target_feature = "simd128")))]
        Self::SCALAR
    }

    /// The kernel for rows of at most 64: 16 lanes are too many for the upper levels of a pyramid.
    /// A CPU with AVX-512 has AVX2 too.
    pub(crate) fn for_short_rows(self) -> Self {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Set::Avx512 => Self(Set::Avx2),
            _ => self,
        }
    }

    /// The kernel with a printed name, if this machine can run it.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::available().find(|kernel| kernel.to_string() == name)
    }
}

/// Whether this CPU has the features of the AVX-512 kernel, and AVX2 for its pyramids.
#[cfg(target_arch = "x86_64")]
fn has_avx512() -> bool {
    is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512bw")
        && is_x86_feature_detected!("avx2")
}

impl fmt::Display for Kernel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.0 {
            Set::Scalar => "scalar",
            #[cfg(all(target_arch = "wasm32", target_feature = "simd128"))]
            Set::Simd128 => "simd128",
            #[cfg(target_arch = "x86_64")]
            Set::Sse41 => "sse4.1",
            #[cfg(target_arch = "x86_64")]
            Set::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Set::Avx512 => "avx512",
        })
    }
}
