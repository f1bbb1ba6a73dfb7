//! Numbers that the formula is evaluated in: f64 for the reference, f32 for the float land, and a
//! value with a bound of its slope for the stability sweep.

use std::ops::{Add, Mul, Neg, Sub};

/// A kind of real number. Curves are methods, so that a kind can bound their slopes more tightly
/// than their products would.
pub trait Real:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Neg<Output = Self>
{
    /// A constant.
    fn of(value: f64) -> Self;
    /// The magnitude.
    fn abs(self) -> Self;
    /// The lesser.
    fn min(self, other: Self) -> Self;
    /// The greater.
    fn max(self, other: Self) -> Self;
    /// Whether it is zero, and stays so nearby if that matters to this kind.
    fn vanishes(self) -> bool;
    /// Rounded to so many fraction bits: for controls.
    fn rounded(self, bits: u32) -> Self;

    /// Cut to a range.
    fn within(self, low: f64, high: f64) -> Self {
        self.max(Self::of(low)).min(Self::of(high))
    }

    /// The square.
    fn square(self) -> Self {
        self * self
    }

    /// `3x² - 2x³` of a share.
    fn smoothstep(self) -> Self {
        self * self * (Self::of(3.0) - Self::of(2.0) * self)
    }

    /// `a + (b - a) t` for a share `t`.
    fn lerp(a: Self, b: Self, t: Self) -> Self {
        a + (b - a) * t
    }

    /// The quadratic B-spline of three nodes at a fraction of the middle cell.
    fn spline([a, b, c]: [Self; 3], t: Self) -> Self {
        let half = Self::of(0.5);
        (a + b) * half + (b - a) * t + (c - b - (b - a)) * t * t * half
    }

    /// `r (0.2 + 1.6 r² - 0.8 r⁴)` for `r` in `[-1, 1]`, and `r` outside.
    fn beach(self) -> Self {
        let r = self.within(-1.0, 1.0);
        let squared = r * r;
        let bent = r * (Self::of(0.2) + squared * (Self::of(1.6) - Self::of(0.8) * squared));
        bent + (self - r)
    }
}

macro_rules! float {
    ($float:ty) => {
        impl Real for $float {
            fn of(value: f64) -> Self {
                value as $float
            }

            fn abs(self) -> Self {
                self.abs()
            }

            fn min(self, other: Self) -> Self {
                self.min(other)
            }

            fn max(self, other: Self) -> Self {
                self.max(other)
            }

            fn vanishes(self) -> bool {
                self == 0.0
            }

            fn rounded(self, bits: u32) -> Self {
                let scale = (1u32 << bits) as $float;
                (self * scale).round() / scale
            }
        }
    };
}

float!(f32);
float!(f64);
