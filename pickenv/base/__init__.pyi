from .container import (
    npz_path as npz_path,
    read_container as read_container,
    refusing_damage as refusing_damage,
    write_container as write_container,
)
from .errors import InputError as InputError
from .extras import (
    EXTRAS as EXTRAS,
    absent_extras as absent_extras,
    command_for as command_for,
    extra_of as extra_of,
    is_there as is_there,
    require as require,
)
from .files import separate as separate, write_json as write_json, write_text as write_text, write_whole as write_whole
from .intervals import (
    Ends as Ends,
    Estimate as Estimate,
    clustered_share_interval as clustered_share_interval,
    estimate as estimate,
    interquartile_estimate as interquartile_estimate,
    mean_interval as mean_interval,
    paired_share_interval as paired_share_interval,
    quantile_levels as quantile_levels,
    share_interval as share_interval,
    statistic_interval as statistic_interval,
)
from .limits import LIMITS as LIMITS, check_limit as check_limit
from .locks import locked as locked
from .provenance import (
    code_fingerprint as code_fingerprint,
    command_line as command_line,
    file_sha256 as file_sha256,
    versions as versions,
)
from .registry import register as register
from .reservations import DO_NOT_USE as DO_NOT_USE, FITTED_FRAMES as FITTED_FRAMES, obey as obey
from .sealed import (
    check_sealed_parquet as check_sealed_parquet,
    parquet_is_sealed as parquet_is_sealed,
    sealed_parquet as sealed_parquet,
)
from .seeds import run_seed as run_seed, seed_words as seed_words, stream as stream
from .texts import (
    decimal_number as decimal_number,
    folded as folded,
    is_file as is_file,
    listed as listed,
    one_line as one_line,
    read_text as read_text,
    screen_width as screen_width,
    shortened as shortened,
    side_by_side as side_by_side,
    yaml_content as yaml_content,
)
from .threads import single_threaded as single_threaded, torch_on_one_thread as torch_on_one_thread
from .toml_tables import (
    ARCMIN as ARCMIN,
    ARCSEC as ARCSEC,
    DEG as DEG,
    DEG_PER_S as DEG_PER_S,
    GRAVITY as GRAVITY,
    HOURS as HOURS,
    KELVIN as KELVIN,
    KG as KG,
    KG_PER_M as KG_PER_M,
    LINE as LINE,
    LX as LX,
    M_PER_S as M_PER_S,
    MILLISECONDS as MILLISECONDS,
    MM as MM,
    MM_PER_S as MM_PER_S,
    NEWTON as NEWTON,
    NEWTON_METRE as NEWTON_METRE,
    NUMBER as NUMBER,
    ONCE as ONCE,
    PX as PX,
    RAD as RAD,
    RAD_PER_S as RAD_PER_S,
    REQUIRED as REQUIRED,
    SECONDS as SECONDS,
    SHARE as SHARE,
    TO_SI as TO_SI,
    UM as UM,
    WHOLE as WHOLE,
    WHOLE_PX as WHOLE_PX,
    Check as Check,
    Key as Key,
    Kinds as Kinds,
    M as M,
    Then as Then,
    Unit as Unit,
    fault as fault,
    file_named as file_named,
    json_schema as json_schema,
    read_toml as read_toml,
    shipped_in as shipped_in,
    toml_of as toml_of,
    toml_table as toml_table,
    units_of as units_of,
)
