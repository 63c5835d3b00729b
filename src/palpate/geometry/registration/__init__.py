"""registration."""

from palpate.geometry.registration.registration import (
    Registration as Registration,
    RegistrationSettings as RegistrationSettings,
    check_registration as check_registration,
    register as register,
)
