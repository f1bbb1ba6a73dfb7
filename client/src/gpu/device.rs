//! The GPU device: adapter selection, opening, fault recording.

use std::sync::{Arc, Mutex, PoisonError};

/// An open GPU.
#[derive(Debug)]
pub struct Gpu {
    /// Kept to recreate surfaces.
    pub instance: wgpu::Instance,
    /// The adapter.
    pub adapter: wgpu::Adapter,
    /// The device.
    pub device: wgpu::Device,
    /// Its queue.
    pub queue: wgpu::Queue,
    faults: Arc<Mutex<Option<String>>>,
}

/// A GPU error.
#[derive(Debug, thiserror::Error)]
pub enum GpuError {
    /// No adapter was found.
    #[error(
        "no GPU adapter found ({0}): install a Vulkan driver, on Debian or Ubuntu `apt install \
         mesa-vulkan-drivers libvulkan1`"
    )]
    NoAdapter(String),
    /// The adapter lacks what portable WebGPU guarantees.
    #[error(
        "the GPU `{adapter}` cannot be used ({cause}): update its driver or choose another with \
         WGPU_ADAPTER_NAME"
    )]
    NoDevice {
        /// Its name.
        adapter: String,
        /// The driver's message.
        cause: String,
    },
    /// The device failed while drawing.
    #[error("the GPU failed: {0}")]
    Fault(String),
}

/// An instance, before there is a device.
pub fn instance(display: Option<Box<dyn wgpu::wgt::WgpuHasDisplayHandle>>) -> wgpu::Instance {
    let mut descriptor = match display {
        Some(display) => wgpu::InstanceDescriptor::new_with_display_handle_from_env(display),
        None => wgpu::InstanceDescriptor::new_without_display_handle_from_env(),
    };
    if cfg!(debug_assertions) {
        // Finds native-only usage in development instead of in a browser.
        descriptor.flags |= wgpu::InstanceFlags::STRICT_WEBGPU_COMPLIANCE;
    }
    wgpu::Instance::new(descriptor)
}

impl Gpu {
    /// Opens the best adapter that can present to `surface`, or the best adapter.
    pub async fn open(
        instance: wgpu::Instance,
        surface: Option<&wgpu::Surface<'_>>,
    ) -> Result<Self, GpuError> {
        Self::open_with(instance, surface, wgpu::Features::empty()).await
    }

    /// [`Gpu::open`] with optional features for measurements; unsupported ones are left out.
    pub async fn open_with(
        instance: wgpu::Instance,
        surface: Option<&wgpu::Surface<'_>>,
        optional: wgpu::Features,
    ) -> Result<Self, GpuError> {
        let options = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            compatible_surface: surface,
            ..Default::default()
        };
        let adapter = instance
            .request_adapter(&options)
            .await
            .map_err(|error| GpuError::NoAdapter(first_line(&error.to_string())))?;
        Self::of_adapter(instance, adapter, optional).await
    }

    /// Opens an adapter of an instance, as [`Gpu::open_with`].
    pub async fn of_adapter(
        instance: wgpu::Instance,
        adapter: wgpu::Adapter,
        optional: wgpu::Features,
    ) -> Result<Self, GpuError> {
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("tombolo"),
            required_features: adapter.features() & optional,
            ..Default::default()
        };
        let (device, queue) = adapter.request_device(&descriptor).await.map_err(|error| {
            GpuError::NoDevice { adapter: adapter.get_info().name, cause: first_line(&error.to_string()) }
        })?;

        let faults = Arc::new(Mutex::new(None));
        let note = |faults: &Arc<Mutex<Option<String>>>| {
            let faults = Arc::clone(faults);
            move |fault: String| {
                // Keeps the first fault: later ones are its consequences.
                faults.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(first_line(&fault));
            }
        };
        let uncaptured = note(&faults);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| uncaptured(error.to_string())));
        let lost = note(&faults);
        device.set_device_lost_callback(move |reason, message| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                lost(format!("the device was lost: {message}"));
            }
        });
        Ok(Self { instance, adapter, device, queue, faults })
    }

    /// Opens the best adapter, without a window. Blocks.
    ///
    /// # Errors
    /// There is no adapter, or its driver refuses.
    pub fn open_blocking() -> Result<Self, GpuError> {
        pollster::block_on(Self::open(instance(None), None))
    }

    /// Whether the driver draws on the CPU.
    #[must_use]
    pub fn is_software(&self) -> bool {
        self.adapter.get_info().device_type == wgpu::DeviceType::Cpu
    }

    /// Name and backend of the adapter, for display.
    #[must_use]
    pub fn name(&self) -> String {
        let info = self.adapter.get_info();
        format!("{} ({})", info.name, info.backend)
    }

    /// Fails with the first fault since the device was opened: later results are invalid.
    pub fn check(&self) -> Result<(), GpuError> {
        match &*self.faults.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(fault) => Err(GpuError::Fault(fault.clone())),
            None => Ok(()),
        }
    }

    /// Blocks until everything submitted is done.
    pub fn wait(&self) -> Result<(), GpuError> {
        self.device
            .poll(wgpu::PollType::wait_indefinitely())
            .map_err(|error| GpuError::Fault(error.to_string()))?;
        self.check()
    }
}

/// A driver's message as one line.
fn first_line(text: &str) -> String {
    let stats = text.lines().map(str::trim).filter(|line| !line.is_empty() && *line != "Caused by:");
    stats.take(4).collect::<Vec<_>>().join("; ")
}
