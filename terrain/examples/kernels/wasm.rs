//! The digests of `kernels` as a WebAssembly module, for a browser or Node to call.
//!
//! Build: `RUSTFLAGS="-C target-feature=+simd128" cargo build --release -p tombolo-terrain
//! --example kernels_wasm --target wasm32-unknown-unknown`
#![expect(unsafe_code, reason = "an export needs its plain name; no pointer crosses")]

mod digest;

use terrain::Kernel;

/// Digest of the plain kernel.
#[unsafe(no_mangle)]
pub extern "C" fn scalar() -> u64 {
    digest::digest(Kernel::SCALAR)
}

/// Digest of the best kernel of this module: of its vectors, if it was built with them.
#[unsafe(no_mangle)]
pub extern "C" fn best() -> u64 {
    digest::digest(Kernel::best())
}
