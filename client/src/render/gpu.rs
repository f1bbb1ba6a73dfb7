//! The device: finding an adapter, opening it, and hearing of its faults.

use std::sync::{Arc, Mutex, PoisonError};

/// An open GPU.
#[derive(Debug)]
pub struct Gpu {
    /// Entry point, kept to recreate surfaces.
    pub instance: wgpu::Instance,
    /// What the device runs on.
    pub adapter: wgpu::Adapter,
    /// The device.
    pub device: wgpu::Device,
    /// Its queue.
    pub queue: wgpu::Queue,
    faults: Arc<Mutex<Option<String>>>,
}

/// Why there is no picture.
#[derive(Debug, thiserror::Error)]
pub enum GpuError {
    /// No driver answers.
    #[error(
        "no GPU adapter found ({0}): install a Vulkan driver, on Debian or Ubuntu `apt install mesa-vulkan-drivers libvulkan1`"
    )]
    NoAdapter(String),
    /// The adapter cannot do what portable WebGPU promises.
    #[error(
        "the GPU `{adapter}` cannot be used ({cause}): update its driver or choose another with WGPU_ADAPTER_NAME"
    )]
    NoDevice {
        /// Its name.
        adapter: String,
        /// The driver's words.
        cause: String,
    },
    /// The device failed while drawing.
    #[error("the GPU failed: {0}")]
    Fault(String),
}

/// What to draw on, before there is a device.
pub fn instance(display: Option<Box<dyn wgpu::wgt::WgpuHasDisplayHandle>>) -> wgpu::Instance {
    let mut descriptor = match display {
        Some(display) => wgpu::InstanceDescriptor::new_with_display_handle_from_env(display),
        None => wgpu::InstanceDescriptor::new_without_display_handle_from_env(),
    };
    if cfg!(debug_assertions) {
        // A native-only habit shows up in development, not in somebody's browser.
        descriptor.flags |= wgpu::InstanceFlags::STRICT_WEBGPU_COMPLIANCE;
    }
    wgpu::Instance::new(descriptor)
}

impl Gpu {
    /// Opens the best adapter that can present to `surface`, or the best of all.
    pub async fn open(
        instance: wgpu::Instance,
        surface: Option<&wgpu::Surface<'_>>,
    ) -> Result<Self, GpuError> {
        Self::open_with(instance, surface, wgpu::Features::empty()).await
    }

    /// The same with features that measuring can use and drawing does without; what the adapter
    /// lacks is left out.
    pub async fn open_with(
        instance: wgpu::Instance,
        surface: Option<&wgpu::Surface<'_>>,
        wished: wgpu::Features,
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
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("tombolo"),
            required_features: adapter.features() & wished,
            ..Default::default()
        };
        let (device, queue) = adapter.request_device(&descriptor).await.map_err(|error| {
            GpuError::NoDevice { adapter: adapter.get_info().name, cause: first_line(&error.to_string()) }
        })?;

        let faults = Arc::new(Mutex::new(None));
        let note = |faults: &Arc<Mutex<Option<String>>>| {
            let faults = Arc::clone(faults);
            move |fault: String| {
                // The first fault is the cause, later ones are its echoes.
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

    /// Opens the best adapter of all, for work without a window. Blocks.
    ///
    /// # Errors
    /// There is no adapter, or its driver refuses.
    pub fn open_blocking() -> Result<Self, GpuError> {
        pollster::block_on(Self::open(instance(None), None))
    }

    /// Name and backend of the adapter, for people.
    #[must_use]
    pub fn name(&self) -> String {
        let info = self.adapter.get_info();
        format!("{} ({})", info.name, info.backend)
    }

    /// The first fault since the device was opened, if any: what was drawn since is not to be
    /// trusted.
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

/// One line of a driver's message: errors are one line each.
fn first_line(text: &str) -> String {
    let told = text.lines().map(str::trim).filter(|line| !line.is_empty() && *line != "Caused by:");
    told.take(4).collect::<Vec<_>>().join("; ")
}
