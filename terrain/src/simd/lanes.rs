//! The operations that a kernel needs from a vector of 32-bit integers.

/// `COUNT` integers of 32 bits. All arithmetic wraps, as in the ring profile.
///
/// # Safety
///
/// Every method may only be called where the CPU has the features of the implementing type;
/// [`super::Kernel`] guarantees that once, at the entry of a kernel. Methods that take pointers
/// read or write `COUNT` integers there, without any alignment beyond that of `i32`.
pub(super) trait Lanes: Copy {
    /// Integers per vector, a power of two up to [`MOST_LANES`].
    const COUNT: usize;
    /// A vector of half as many integers that needs no further features, for the rest of a row. One
    /// lane is its own half.
    type Half: Lanes;

    unsafe fn load(from: *const i32) -> Self;
    unsafe fn store(self, to: *mut i32);
    unsafe fn splat(value: i32) -> Self;
    /// 0, 1, 2, ...
    unsafe fn ramp() -> Self;

    unsafe fn add(self, other: Self) -> Self;
    unsafe fn sub(self, other: Self) -> Self;
    /// Low half of the product.
    unsafe fn mul(self, other: Self) -> Self;
    /// High half of the signed product.
    unsafe fn mul_hi(self, other: Self) -> Self;
    /// High half of the unsigned product.
    unsafe fn mul_hi_u(self, other: Self) -> Self;
    /// Per lane, the sum of the products of the two signed 16-bit halves.
    unsafe fn dot(self, other: Self) -> Self;
    unsafe fn and(self, other: Self) -> Self;
    unsafe fn xor(self, other: Self) -> Self;
    unsafe fn min(self, other: Self) -> Self;
    unsafe fn max(self, other: Self) -> Self;
    /// Magnitude; the lowest integer stays as it is.
    unsafe fn abs(self) -> Self;

    /// Left shift of all lanes by the same number of bits below 32.
    unsafe fn shl(self, bits: u32) -> Self;
    /// Right shift that fills with zeros.
    unsafe fn shr(self, bits: u32) -> Self;
    /// Right shift that fills with the sign.
    unsafe fn sar(self, bits: u32) -> Self;

    /// Low 16 bits of `self`, and above them the low 16 bits of `high`.
    unsafe fn pack(self, high: Self) -> Self;
    /// Per lane, `then` where `self < limit` (signed), else `otherwise`.
    unsafe fn select_below(self, limit: Self, then: Self, otherwise: Self) -> Self;
    /// Whether any lane differs from zero.
    unsafe fn any(self) -> bool;

    /// The argument of [`Lanes::window`] that picks the elements at `offsets` (each below `COUNT`).
    unsafe fn picker(offsets: Self) -> Self;
    /// Per lane, the element of the `COUNT` integers at `from` that the picker names.
    unsafe fn window(from: *const i32, picker: Self) -> Self;
    /// Per lane, `table[index]`; every index is below 32.
    unsafe fn lookup(table: &[i32; 32], index: Self) -> Self;

    /// Maxima of neighbours: lane `i` is the larger of elements `2 i` and `2 i + 1` of the sequence
    /// `self, next`.
    unsafe fn max_of_pairs(self, next: Self) -> Self;
    /// Minima of neighbours, in the same order.
    unsafe fn min_of_pairs(self, next: Self) -> Self;
}

/// Most lanes of any implementation; buffers are padded for it.
pub(super) const MOST_LANES: usize = 16;

/// Stores the first `count` lanes, or all of them.
#[inline(always)]
pub(super) unsafe fn store_some<L: Lanes>(lanes: L, to: *mut i32, count: usize) {
    // SAFETY: the caller guarantees `count` integers at `to` and the CPU features.
    unsafe {
        if count >= L::COUNT {
            lanes.store(to);
        } else {
            let mut all = [0; MOST_LANES];
            lanes.store(all.as_mut_ptr());
            for (index, value) in all.iter().enumerate().take(count) {
                *to.add(index) = *value;
            }
        }
    }
}

/// One lane: the portable kernel.
impl Lanes for i32 {
    const COUNT: usize = 1;
    type Half = Self;

    #[inline(always)]
    unsafe fn load(from: *const i32) -> Self {
        // SAFETY: the caller guarantees the pointer, here and below.
        unsafe { *from }
    }
    #[inline(always)]
    unsafe fn store(self, to: *mut i32) {
        // SAFETY: see `load`.
        unsafe { *to = self }
    }
    #[inline(always)]
    unsafe fn splat(value: i32) -> Self {
        value
    }
    #[inline(always)]
    unsafe fn ramp() -> Self {
        0
    }

    #[inline(always)]
    unsafe fn add(self, other: Self) -> Self {
        self.wrapping_add(other)
    }
    #[inline(always)]
    unsafe fn sub(self, other: Self) -> Self {
        self.wrapping_sub(other)
    }
    #[inline(always)]
    unsafe fn mul(self, other: Self) -> Self {
        self.wrapping_mul(other)
    }
    #[inline(always)]
    unsafe fn mul_hi(self, other: Self) -> Self {
        crate::ring::mul_hi(self, other)
    }
    #[inline(always)]
    unsafe fn mul_hi_u(self, other: Self) -> Self {
        crate::ring::mul_hi_u(self as u32, other as u32) as i32
    }
    #[inline(always)]
    unsafe fn dot(self, other: Self) -> Self {
        let low = |pair: i32| i32::from(pair as i16);
        (low(self) * low(other)).wrapping_add((self >> 16) * (other >> 16))
    }
    #[inline(always)]
    unsafe fn and(self, other: Self) -> Self {
        self & other
    }
    #[inline(always)]
    unsafe fn xor(self, other: Self) -> Self {
        self ^ other
    }
    #[inline(always)]
    unsafe fn min(self, other: Self) -> Self {
        Ord::min(self, other)
    }
    #[inline(always)]
    unsafe fn max(self, other: Self) -> Self {
        Ord::max(self, other)
    }
    #[inline(always)]
    unsafe fn abs(self) -> Self {
        self.wrapping_abs()
    }

    #[inline(always)]
    unsafe fn shl(self, bits: u32) -> Self {
        self << bits
    }
    #[inline(always)]
    unsafe fn shr(self, bits: u32) -> Self {
        ((self as u32) >> bits) as i32
    }
    #[inline(always)]
    unsafe fn sar(self, bits: u32) -> Self {
        self >> bits
    }

    #[inline(always)]
    unsafe fn pack(self, high: Self) -> Self {
        (self & 0xffff) | (high << 16)
    }
    #[inline(always)]
    unsafe fn select_below(self, limit: Self, then: Self, otherwise: Self) -> Self {
        if self < limit { then } else { otherwise }
    }
    #[inline(always)]
    unsafe fn any(self) -> bool {
        self != 0
    }

    #[inline(always)]
    unsafe fn picker(offsets: Self) -> Self {
        offsets
    }
    #[inline(always)]
    unsafe fn window(from: *const i32, _: Self) -> Self {
        // SAFETY: see `load`; with one lane the only offset is 0.
        unsafe { *from }
    }
    #[inline(always)]
    unsafe fn lookup(table: &[i32; 32], index: Self) -> Self {
        table[index as usize & 31]
    }

    #[inline(always)]
    unsafe fn max_of_pairs(self, next: Self) -> Self {
        Ord::max(self, next)
    }
    #[inline(always)]
    unsafe fn min_of_pairs(self, next: Self) -> Self {
        Ord::min(self, next)
    }
}
