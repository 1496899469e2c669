# The ROS 2 wheels export targets that name include folders of the machine that built them
# (/opt/python/...). CMake refuses a target whose include folder does not exist, so drop those
# entries once every package is found. Given as CMAKE_PROJECT_INCLUDE; a stock ROS needs it not.
function(drop_foreign_include_folders)
  get_property(targets DIRECTORY "${CMAKE_SOURCE_DIR}" PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(folders "${target}" INTERFACE_INCLUDE_DIRECTORIES)
    if(folders)
      set(kept "${folders}")
      list(FILTER kept EXCLUDE REGEX "^/opt/python/")
      if(NOT kept STREQUAL folders)
        set_target_properties("${target}" PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${kept}")
      endif()
    endif()
  endforeach()
endfunction()

cmake_language(DEFER DIRECTORY "${CMAKE_SOURCE_DIR}" CALL drop_foreign_include_folders)
