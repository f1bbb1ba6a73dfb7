//! Every limit of the protocol, in one place. A message beyond a limit is refused or closes the
//! connection; all memory is bounded.

use terrain::constants::{GRASS_GRID, VERTEX_COUNT};

/// Longest control frame in bytes, either direction. Holds [`MAX_KEYS`] keys with a margin.
pub const MAX_CONTROL_FRAME: usize = 8 * 1024;

/// Keys in one request, release or holding message.
pub const MAX_KEYS: usize = 512;

/// Chunks that a client may have granted and not yet received. A larger grant is refused, a
/// larger sum of grants is cut to it.
pub const MAX_CREDITS: u32 = 4096;

/// Bytes of chunk frames that a client may have granted and not yet received. A larger grant is
/// refused, a larger sum of grants is cut to it.
pub const MAX_CREDIT_BYTES: u32 = 256 << 20;

/// Requested keys that a server queues per session; a request that would exceed it is refused
/// whole.
pub const MAX_PENDING_REQUESTS: usize = 1024;

/// Chunks selected for one view. A view that needs more gets the coarsest of them, and of the last
/// level that fits in part the most urgent ones.
pub const MAX_VIEW_CHUNKS: usize = 16 * 1024;

/// Estimated chunks of a view ([`terrain::lod::estimated_chunks`]) beyond which a server refuses it
/// as [`crate::message::RefusalReason::InvalidView`]. Views between [`MAX_VIEW_CHUNKS`] and this
/// get the coarsest chunks.
pub const MAX_VIEW_ESTIMATE: u64 = 16 * MAX_VIEW_CHUNKS as u64;

/// Side of the tiles in which server and viewer store the chunks that a client holds, chunks.
pub const HELD_TILE: i32 = 16;

/// Tiles with held chunks that either stores per session: 164 KiB, and at most 917,504 chunks. A
/// full set is cleared; the only consequence is that chunks may be sent again.
pub const MAX_HELD_TILES: usize = 3584;

/// Chunks in the reference window of refined delivery: 17 MiB of heights in the client, some KiB of
/// keys in the server.
pub const MAX_REFERENCES: usize = 1024;

/// Longest text field (software name, token, detail) in bytes.
pub const MAX_TEXT: usize = 256;

/// Largest viewport side in pixels.
pub const MAX_VIEWPORT: u16 = 16_384;

/// Bytes of the header of a chunk frame that carries heights.
pub const CHUNK_HEADER: usize = 60;

/// Bytes of a seed-only chunk frame: all of it.
pub const SEED_ONLY_FRAME: usize = 36;

/// Bytes of a grass record as the seed-only digest covers it: seed, palette, density.
pub const GRASS_RECORD: usize = 4 + 1 + GRASS_GRID * GRASS_GRID;

/// Bits that the widest zigzag residual of valid heights can have: four heights below 2^24 and a
/// sign.
pub const MAX_RESIDUAL_BITS: u32 = 27;

/// Bytes of the longest payload: grass seed and palette, the number of plain bits, three whole byte
/// planes and a packed one of up to 4 bits a vertex (plain bits only ever take the place of as many
/// others), the grass densities, and a length before each. A part is never stored longer than
/// its content.
pub const MAX_PAYLOAD: usize =
    6 + 3 * (2 + VERTEX_COUNT) + (2 + VERTEX_COUNT.div_ceil(2)) + (2 + GRASS_GRID * GRASS_GRID);

/// Longest chunk frame in bytes.
pub const MAX_CHUNK_FRAME: usize = CHUNK_HEADER + MAX_PAYLOAD;

/// Most bytes that decoding one chunk frame takes from the heap, the chunk itself included, for any
/// input. In addition, each decoding thread keeps one scratch buffer of about the same size.
pub const MAX_DECODE_MEMORY: usize = 96 * 1024;

/// Longest frame of any kind that a client accepts, bytes.
pub const MAX_SERVER_FRAME: usize =
    if MAX_CHUNK_FRAME > MAX_CONTROL_FRAME { MAX_CHUNK_FRAME } else { MAX_CONTROL_FRAME };
